"""The compose file: both nodes, the page on this machine, and a display behind a bad link."""

import json
import shutil
import subprocess
import uuid
from collections.abc import Iterator
from urllib.error import URLError
from urllib.request import urlopen

import pytest

from tests.support.nodes import ROOT
from tests.support.waiting import until

BUILT_AND_STARTED_S = 60
PROFILES = ("--profile", "view", "--profile", "wan")


def compose_command() -> list[str] | None:
    """Return the command of either version of compose; None without any."""
    for command in (["docker", "compose"], ["docker-compose"]):
        if shutil.which(command[0]) is None:
            continue
        if subprocess.run([*command, "version"], capture_output=True, check=False).returncode == 0:
            return command
    return None


def missing() -> str | None:
    """Return what is missing to run the compose file; None where nothing is."""
    if compose_command() is None:
        return "needs Docker's compose"
    shown = ["docker", "image", "inspect", "telepulse"]
    if subprocess.run(shown, capture_output=True, check=False).returncode != 0:
        return "needs an engine, and the image: docker compose build"
    return None


@pytest.fixture
def project() -> Iterator[list[str]]:
    """Return compose's command for a project of this test, which is removed afterwards."""
    if (reason := missing()) is not None:
        pytest.skip(reason)
    command = compose_command()
    assert command is not None
    command += ["--project-name", f"telepulse-{uuid.uuid4().hex[:8]}", *PROFILES]
    yield command
    down = [*command, "down", "--volumes", "--timeout", "5"]
    subprocess.run(down, cwd=ROOT, capture_output=True, check=True)


def logs(project: list[str], service: str) -> str:
    command = [*project, "logs", "--no-color", service]
    return subprocess.run(
        command, cwd=ROOT, capture_output=True, encoding="utf-8", check=True
    ).stdout


def page(port: int) -> str:
    try:
        with urlopen(f"http://localhost:{port}/", timeout=5) as answer:
            return str(answer.read().decode())
    except (URLError, OSError):
        return ""


@pytest.mark.timeout(240)
def test_both_displays_play_and_their_pages_are_published_here_alone(project: list[str]) -> None:
    up = [*project, "up", "--detach", "--no-build"]
    started = subprocess.run(up, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    assert started.returncode == 0, started.stderr
    for port in (5006, 5007):
        until(lambda port=port: "telepulse" in page(port), BUILT_AND_STARTED_S)
    for name in ("display", "display-wan"):
        until(lambda name=name: "the network took" in logs(project, name), BUILT_AND_STARTED_S)
    # A delay of 40 ms on the way, and none.
    medians_ms = [
        float(logs(project, name).split("the network took ")[1].split(" ms")[0])
        for name in ("display", "display-wan")
    ]
    assert medians_ms[0] < 20 < medians_ms[1]
    shown = [*project, "ps", "--quiet", "display"]
    found = subprocess.run(
        shown, cwd=ROOT, capture_output=True, encoding="utf-8", check=True
    ).stdout
    inspected = ["docker", "inspect", found.strip()]
    (container,) = json.loads(
        subprocess.run(inspected, capture_output=True, encoding="utf-8", check=True).stdout
    )
    (published,) = container["HostConfig"]["PortBindings"].values()
    assert published == [{"HostIp": "127.0.0.1", "HostPort": "5006"}]
