"""A finger that presses an emulated wrist by an emulated drive: board, drive and both nodes.

On a busy machine a watchdog may stop the probe; then the bench is started again.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import TimeoutExpired

import numpy as np
import pytest

from protocol.cli_options import FAULT_STATUS
from protocol.faults import FaultKind, faults_of
from tests.support.emulated_bench import EmulatedBench, MotorTrace
from tests.support.nodes import read_json
from tests.support.waiting import until
from tests.system.drives.attempts import TRIES

STARTS_WITHIN_S, ENDS_WITHIN_S = 30.0, 30.0
# The modelled finger of the scene presses with these forces, for 4 s each, after a first one that
# passes while the drive homes.
LEVELS_N = (1.2, 0.9)
LIMIT_N = 3.0
# A busy machine is allowed for; the scene's watchdog stops the probe an eighth as late.
WATCHDOG_S, MAX_SPEED_M_PER_S = 0.4, 0.03


@contextmanager
def pressed_wrist(folder: Path, seconds: int, *options: str) -> Iterator[EmulatedBench]:
    """Start drive, wrist and finger; options: of the drive's emulator."""
    bench = EmulatedBench(folder, "tmcl", name="real_press")
    text = bench.scene.read_text("utf-8")
    patient = f'[sensing.press.drive]\nwatchdog = "{WATCHDOG_S} s"\nreply_timeout = "100 ms"\n'
    text = text.replace("[sensing.press.drive]\n", patient)
    text = text.replace("[sensing.press]\n", '[sensing.press]\ncell_within = "100 ms"\n')
    bench.scene.write_text(text, encoding="utf-8")
    links = ("--link", folder / "probe", "--film-link", folder / "wrist")
    drive = ("--wrist", "press", *links, "--trace", folder / "motor.csv", *options)
    wrist = ("--bind", bench.address, "--seconds", seconds, "--json", folder / "sensing.json")
    finger = ("--connect", bench.address, "--telemetry", bench.telemetry, "--once")
    try:
        bench.start("drive", "telepulse", "emulate", "tmcl", bench.scene, *drive)
        until((folder / "wrist").exists, STARTS_WITHIN_S)
        bench.start("sensing", "sensing_node.cli", bench.scene, *wrist, "--quiet")
        json_file = folder / "display.json"
        words = (bench.scene, *finger, "--quiet", "--json", json_file)
        bench.start("display", "display_node.cli", *words)
        yield bench
        bench.end()
    finally:
        bench.kill()


def held_s(motor: MotorTrace, level_n: float) -> float:
    """Return for how many seconds the force was within 5 % of a level."""
    near = np.abs(motor.force_n / level_n - 1) < 0.05
    return float(near.mean() * np.ptp(motor.time_ns)) * 1e-9


def test_the_hold_down_follows_the_finger_and_the_probe_leaves_at_the_end(tmp_path: Path) -> None:
    for attempt in range(TRIES):
        (folder := tmp_path / str(attempt)).mkdir()
        try:
            with pressed_wrist(folder, 9) as bench:
                wrist_status = bench.processes["sensing"].wait(ENDS_WITHIN_S)
                bench.processes["display"].wait(ENDS_WITHIN_S)
        except TimeoutExpired:
            # The display had not joined the stream before its end.
            continue
        here, there = (read_json(folder / f"{name}.json") for name in ("display", "sensing"))
        if not there["faults"]:
            break
    else:
        pytest.fail(f"no run without a fault in {TRIES} attempts")
    assert wrist_status == 0
    account = here["press"]
    assert account["sent"] == account["applied"] + account["superseded"] + account["lost"] > 100
    motor = bench.motor()
    for level_n in LEVELS_N:
        assert held_s(motor, level_n) > 1.0
    assert motor.force_n.max() < LIMIT_N
    assert motor.force_n[-1] == 0


@pytest.mark.parametrize(
    ("name", "kind", "leaves"),
    [("film-silent", FaultKind.SILENT, True), ("unplugged", FaultKind.UNPLUGGED, False)],
)
def test_a_fault_takes_the_probe_off_the_wrist_or_leaves_it_at_rest(
    name: str, kind: FaultKind, leaves: bool, tmp_path: Path
) -> None:
    with pressed_wrist(tmp_path, 6, "--fault", name, "--fault-after", "1") as bench:
        wrist_status = bench.processes["sensing"].wait(ENDS_WITHIN_S)
    found = read_json(tmp_path / "sensing.json")
    assert kind in [fault.kind for fault in faults_of(found)]
    assert found["press"]["probe"] == "fault"
    assert wrist_status == FAULT_STATUS
    motor = bench.motor()
    # Unplugged, a probe that moves goes on until the drive's watchdog stops it.
    assert motor.force_n.max() < LIMIT_N or not leaves
    assert not motor.speed_m_per_s[-50:].any()
    assert bool(motor.force_n[-1] == 0) is leaves


def test_a_killed_sensing_node_leaves_the_probe_to_its_drives_watchdog(tmp_path: Path) -> None:
    with pressed_wrist(tmp_path, 30) as bench:

        def pressed_for_a_second() -> bool:
            motor = bench.motor()
            pressing = motor.time_ns[motor.force_n > 0.5 * LEVELS_N[0]]
            return bool(len(pressing) and motor.time_ns[-1] - pressing[0] > 1e9)

        bench.await_state("playing")
        until(pressed_for_a_second, 60.0)
        killed_ns = time.monotonic_ns()
        bench.processes["sensing"].kill()
        time.sleep(1.5)
    motor = bench.motor()
    after = motor.time_ns > killed_ns
    moving_s = (motor.time_ns[after & (motor.speed_m_per_s != 0)] - killed_ns) * 1e-9
    assert moving_s.max(initial=0.0) < WATCHDOG_S + 0.2
    travel_m = np.trapezoid(motor.speed_m_per_s[after], motor.time_ns[after] * 1e-9)
    assert abs(travel_m) < MAX_SPEED_M_PER_S * WATCHDOG_S
    assert motor.force_n[-1] > 0
