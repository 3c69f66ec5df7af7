"""A finger that presses an emulated wrist by an emulated drive: board, drive and both nodes.

On a busy machine a watchdog may stop the probe; then the bench is started again.
"""

import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from protocol.cli_options import FAULT_STATUS
from protocol.config.scene_file import find_scene, load_document, to_toml
from protocol.host.child_process import ChildProcess
from tests.support.nodes import free_address, process, read_json
from tests.support.waiting import until

NICE, TRIES, STARTS_WITHIN_S, ENDS_WITHIN_S = -15, 4, 30.0, 30.0
# The modelled finger of the scene presses with these forces, for 4 s each, after a first one that
# passes while the drive homes.
LEVELS_N = (1.2, 0.9)
LIMIT_N = 3.0


class Trace(NamedTuple):
    """The emulated motor's record: time in s, speed, and the true force on the wrist."""

    time_s: NDArray[np.float64]
    speed_m_per_s: NDArray[np.float64]
    force_n: NDArray[np.float64]


class PressedWrist:
    """The processes and files of a pressed wrist."""

    def __init__(self, folder: Path, seconds: int, *options: str) -> None:
        self.folder, self.scene = folder, folder / "scene.toml"
        text = to_toml(load_document(find_scene("real_press")))
        patient = '[sensing.press.drive]\nwatchdog = "400 ms"\nreply_timeout = "100 ms"\n'
        text = text.replace("[sensing.press.drive]\n", patient)
        text = text.replace("[sensing.press]\n", '[sensing.press]\ncell_within = "100 ms"\n')
        self.scene.write_text(text.replace("/tmp/telepulse-", f"{folder}/"), encoding="utf-8")
        self._options, self._stack, address = options, ExitStack(), free_address()
        self._wrist = (
            "--bind",
            address,
            "--seconds",
            str(seconds),
            "--json",
            str(folder / "wrist.json"),
            "--quiet",
        )
        finger = ("--connect", address, "--telemetry", "tcp://127.0.0.1:*", "--quiet", "--once")
        self._finger = (*finger, "--json", str(folder / "finger.json"))

    @contextmanager
    def started(self) -> Iterator[tuple[ChildProcess, ChildProcess]]:
        """Start all, and yield the nodes at wrist and finger."""
        scene, folder = str(self.scene), self.folder
        links = ("--link", str(folder / "probe"), "--film-link", str(folder / "wrist"))
        trace = ("--trace", str(folder / "motor.csv"))
        words = ("emulate", "tmcl", scene, "--wrist", "press", *links, *trace, *self._options)
        with self._process("telepulse", *words) as drive:
            until(lambda: (folder / "wrist").exists(), STARTS_WITHIN_S)
            with (
                self._process("sensing_node.cli", scene, *self._wrist) as wrist,
                process("display_node.cli", scene, *self._finger) as finger,
            ):
                yield wrist, finger
            drive.terminate()
            drive.wait(ENDS_WITHIN_S)

    @contextmanager
    def _process(self, module: str, *words: str) -> Iterator[ChildProcess]:
        with process(module, *words) as child:
            # Drive and emulator share a watchdog in real time, where the priority is permitted.
            with suppress(PermissionError):
                os.setpriority(os.PRIO_PROCESS, child.pid, NICE)
            yield child

    def trace(self) -> Trace:
        path, columns = self.folder / "motor.csv", (0, 2, 3)
        lines = path.read_text("utf-8").splitlines()[1:-1] if path.exists() else []
        if not lines:
            return Trace(np.zeros(0), np.zeros(0), np.zeros(0))
        rows = np.loadtxt(lines, delimiter=",", usecols=columns, ndmin=2)
        return Trace(rows[:, 0] * 1e-9, rows[:, 1], rows[:, 2])

    def pressed(self, seconds: float) -> bool:
        """Return whether the wrist has been pressed for so long by now."""
        trace = self.trace()
        pressing = np.flatnonzero(trace.force_n > 0.5 * LEVELS_N[0])
        return bool(len(pressing) and trace.time_s[-1] - trace.time_s[pressing[0]] > seconds)

    def held(self, level_n: float) -> float:
        """Return for how many seconds the force was within 5 % of a level."""
        return float(np.mean(np.abs(self.trace().force_n / level_n - 1) < 0.05)) * (
            np.ptp(self.trace().time_s)
        )


def test_the_hold_down_follows_the_finger_and_the_probe_leaves_at_the_end(tmp_path: Path) -> None:
    for attempt in range(TRIES):
        (folder := tmp_path / str(attempt)).mkdir()
        bench = PressedWrist(folder, 9)
        with bench.started() as (wrist, finger):
            wrist.wait(ENDS_WITHIN_S)
            finger.wait(ENDS_WITHIN_S)
        here, there = (read_json(folder / f"{name}.json") for name in ("finger", "wrist"))
        if not there["faults"]:
            break
    assert not there["faults"]
    assert wrist.returncode == 0
    account = here["press"]
    assert account["sent"] == account["applied"] + account["superseded"] + account["lost"] > 100
    trace = bench.trace()
    for level_n in LEVELS_N:
        assert bench.held(level_n) > 1.0
    assert trace.force_n.max() < LIMIT_N
    assert trace.force_n[-1] == 0


@pytest.mark.parametrize(
    ("name", "fault", "leaves"),
    [("film-silent", "load cell: silent", True), ("unplugged", "drive: unplugged", False)],
)
def test_a_fault_takes_the_probe_off_the_wrist_or_leaves_it_at_rest(
    name: str, fault: str, leaves: bool, tmp_path: Path
) -> None:
    bench = PressedWrist(tmp_path, 6, "--fault", name, "--fault-after", "1")
    with bench.started() as (wrist, _):
        wrist.wait(ENDS_WITHIN_S)
    found = read_json(tmp_path / "wrist.json")
    assert fault in " ".join(found["faults"])
    assert found["press"]["probe"] == "fault"
    assert wrist.returncode == FAULT_STATUS
    trace = bench.trace()
    assert trace.force_n.max() < LIMIT_N
    assert not trace.speed_m_per_s[-50:].any()
    assert bool(trace.force_n[-1] == 0) is leaves


def test_a_killed_sensing_node_leaves_the_probe_to_its_drives_watchdog(tmp_path: Path) -> None:
    bench = PressedWrist(tmp_path, 30)
    with bench.started() as (wrist, _):
        until(lambda: bench.pressed(1.0), 60.0)
        wrist.kill()
        time.sleep(1.5)
    trace = bench.trace()
    assert not trace.speed_m_per_s[-50:].any()
    assert 0 < trace.force_n.max() < LIMIT_N
