"""The compose file: both nodes, their pages and figures, and a display behind a bad link."""

import json
import shutil
import subprocess
import uuid
from collections.abc import Iterator
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

import pytest
import yaml

from tests.support.nodes import ROOT
from tests.support.waiting import until

BUILT_AND_STARTED_S = 60
SERVICES: dict[str, Any] = yaml.safe_load(
    (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
)["services"]
PROFILES = ("--profile", "view", "--profile", "wan", "--profile", "metrics")


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
    if not has_image("telepulse"):
        return "needs an engine, and the image: docker compose build"
    return None


def has_image(name: str) -> bool:
    shown = ["docker", "image", "inspect", name]
    return subprocess.run(shown, capture_output=True, check=False).returncode == 0


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


def start(project: list[str], *services: str) -> None:
    """Start services, and those that they need."""
    up = [*project, "up", "--detach", "--no-build", *services]
    started = subprocess.run(up, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    assert started.returncode == 0, started.stderr


def inspected(project: list[str], service: str) -> dict[str, Any]:
    """Return what the engine knows of a service's container."""
    shown = [*project, "ps", "--quiet", service]
    found = subprocess.run(
        shown, cwd=ROOT, capture_output=True, encoding="utf-8", check=True
    ).stdout
    command = ["docker", "inspect", found.strip()]
    (container,) = json.loads(
        subprocess.run(command, capture_output=True, encoding="utf-8", check=True).stdout
    )
    return dict(container)


def are_up(query: str) -> set[str]:
    """Return the instances of which Prometheus has a figure that is 1."""
    try:
        url = f"http://localhost:9090/api/v1/query?query={query}"
        with urlopen(url, timeout=5) as answer:
            found = json.loads(answer.read())["data"]["result"]
    except (URLError, OSError):
        return set()
    return {each["metric"]["instance"] for each in found if float(each["value"][1]) == 1.0}


@pytest.mark.timeout(240)
def test_both_displays_play_and_their_pages_are_published_here_alone(project: list[str]) -> None:
    start(project, "view", "view-wan", "link", "sensing")
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
    (published,) = inspected(project, "display")["HostConfig"]["PortBindings"].values()
    assert published == [{"HostIp": "127.0.0.1", "HostPort": "5006"}]


@pytest.mark.timeout(240)
def test_a_sensing_node_that_is_killed_starts_again_and_its_health_is_known(
    project: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TELEPULSE_SECONDS", "600")
    start(project, "sensing")
    for name in ("display", "sensing"):

        def health(name: str = name) -> str:
            return str(inspected(project, name)["State"]["Health"]["Status"])

        until(lambda health=health: health() == "healthy", BUILT_AND_STARTED_S)
    # The program itself, as the kernel would do where memory is short: the engine's own kill is
    # taken for a wish.
    killed = [*project, "exec", "-T", "sensing", "sh", "-c", "kill -9 -1"]
    subprocess.run(killed, cwd=ROOT, capture_output=True, check=False)
    until(lambda: inspected(project, "sensing")["RestartCount"] == 1, BUILT_AND_STARTED_S)
    until(lambda: health() == "healthy", BUILT_AND_STARTED_S)


@pytest.mark.timeout(240)
def test_prometheus_has_the_figures_of_both_nodes(
    project: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    if not has_image(SERVICES["prometheus"]["image"]):
        pytest.skip("needs the image of Prometheus: docker compose --profile metrics pull")
    monkeypatch.setenv("TELEPULSE_SECONDS", "600")
    start(project, "sensing", "prometheus")
    both = {"display:9100", "sensing:9100"}
    until(lambda: are_up("telepulse_up") == both, BUILT_AND_STARTED_S)
