"""The sweep as a command: on a model, live, stopped, recorded, and its recording pressed."""

import json
import signal
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from protocol.wire import messages as wire
from tests.support.nodes import ROOT, free_address, process, run
from tests.support.sensing_client import Client
from tests.system.nodes.test_press_nodes import await_hold_down, set_point

pytestmark = pytest.mark.system
SCENE = str(ROOT / "scenes" / "press.toml")
MODULE = "telepulse"


@pytest.mark.smoke
def test_a_modelled_wrist_is_swept_and_reported(tmp_path: Path) -> None:
    out, tables = tmp_path / "out", tmp_path / "tables.json"
    done = run(MODULE, "sweep", SCENE, "--out", str(out), "--json", str(tables))
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("beats\n") >= 10
    assert (out / "index.html").exists()
    levels = json.loads(tables.read_text())["chapters"][0]["tables"][0]["rows"]
    forces_n = [float(row["hold-down (N)"].split(" ")[0]) for row in levels]
    assert forces_n == sorted(forces_n)
    # The mean arterial pressure of the scene, 12.2 kPa, on 0.985 cm².
    assert forces_n[1] == pytest.approx(1.2, rel=0.05)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("radial",), 'its source is of kind "synthetic", which only a sensing node can press'),
        (("press", "--low", "2 N"), "--high 2.5 N: give at least twice --low, 2 N"),
        (("press", "--low", "1 mm"), "--low: "),
        (("press", "--record", "a.mcap"), "--record needs --connect"),
    ],
)
def test_what_cannot_be_swept_is_one_line(arguments: tuple[str, ...], reason: str) -> None:
    done = run(MODULE, "sweep", *arguments)
    assert done.returncode == 2
    assert reason in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.timeout(200)
def test_a_live_sweep_is_recorded_and_its_recording_pressed(tmp_path: Path) -> None:
    address, again = free_address(), free_address()
    recording = tmp_path / "sweep.mcap"
    live = ("sweep", SCENE, "--connect", address, "--ramp", "20", "--low", "0.6 N")
    live += ("--high", "1.8 N", "--out", str(tmp_path / "out"), "--record", str(recording))
    with process("sensing_node.cli", SCENE, "--bind", address, "--quiet"):
        done = run(MODULE, *live)
        assert done.returncode == 0, done.stderr
        with process(MODULE, *live[:4], "--out", str(tmp_path / "stopped")) as stopped:
            with closing(Client(address)) as client:
                client.join()
                await_hold_down(client, 0.15, 0.3)
            stopped.send_signal(signal.SIGINT)
            _, errors = stopped.communicate(timeout=30)
        assert stopped.returncode == 2
        assert "too few beats for a curve" in errors
    heights_n = {}
    arguments = (str(recording), "--press", "--bind", again, "--quiet")
    with process(MODULE, "replay", *arguments), closing(Client(again)) as client:
        session, number = client.join().session, 0
        for force_n in (0.8, 1.2):
            values = []
            for _ in range(200):
                client.ask(set_point(session, 1, number, force_n))
                number += 1
                values.append(wire.decode_frame(client.data.recv()).values)
            heights_n[force_n] = float(np.ptp(np.concatenate(values)[-500:, 0]))
    assert heights_n[1.2] > 1.5 * heights_n[0.8] > 0.1
