"""The sweep as a command: on a model, live, stopped, recorded, and its recording pressed."""

import json
import signal
import urllib.request
from contextlib import closing
from pathlib import Path

import pytest

from tests.support.keyring import Keyring
from tests.support.nodes import ROOT, process, run
from tests.support.sensing_client import Client
from tests.system.nodes.test_press_nodes import await_hold_down, newest_hold_down

pytestmark = pytest.mark.system
SCENE = str(ROOT / "scenes" / "press.toml")
MODULE = "telepulse"


def test_a_modelled_wrist_is_swept_and_reported(tmp_path: Path) -> None:
    out, tables = tmp_path / "out", tmp_path / "tables.json"
    done = run(MODULE, "sweep", SCENE, "--out", str(out), "--json", str(tables))
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("beats\n") >= 10
    assert (out / "index.html").exists()
    levels = json.loads(tables.read_text(encoding="utf-8"))["chapters"][0]["tables"][0]["rows"]
    forces_n = [float(row["hold-down (N)"].split(" ")[0]) for row in levels]
    assert forces_n == sorted(forces_n)
    # The mean arterial pressure of the scene, 12.2 kPa, on 0.985 cm².
    assert forces_n[1] == pytest.approx(1.2, rel=0.05)


def test_a_stopped_live_sweep_eases_off_and_names_what_is_missing(
    address: str, tmp_path: Path
) -> None:
    keyring = Keyring(tmp_path / "keys")
    keyring.allow("finger")
    live = (
        *("sweep", SCENE, "--connect", address, "--out", str(tmp_path / "out")),
        *("--peer", keyring.path("wrist", "pub")),
    )
    stranger, finger = (("--key", keyring.path(name)) for name in ("stranger", "finger"))
    wrist = (SCENE, "--bind", address, "--key", keyring.path("wrist"), "--quiet")
    with (
        process("sensing_node.cli", *wrist) as sensing,
        closing(Client(address, keyring.client("finger"))) as client,
    ):
        client.join()
        with process(MODULE, *live, *stranger) as refused:
            assert "is not allowed" in sensing.read_line(30, from_stderr=True)
            assert abs(newest_hold_down(client)) < 0.05
            refused.kill()
        with process(MODULE, *live, *finger, "--page") as stopped:
            await_hold_down(client, 0.15, 0.25)
            page = stopped.read_line(30).removeprefix("page: ")
            assert "by hold-down" in urllib.request.urlopen(page, timeout=30).read().decode()
            stopped.send_signal(signal.SIGINT)
            _, errors = stopped.communicate(timeout=30)
            await_hold_down(client, -0.05, 0.05)
    assert stopped.returncode == 2
    assert "too few beats for a curve" in errors
