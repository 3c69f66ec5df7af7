"""Contactors on emulated drives, each a process: one instant, one safety."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np

from protocol.faults import faults_of
from protocol.finger import finger_in
from tests.support.emulated_bench import BenchFailedError, EmulatedBench, MotorTrace
from tests.support.waiting import until
from tests.system.drives.attempts import PATIENCE_MS, on_bench

CONTACTORS = ("cun", "guan", "chi")
# The pulse wave takes 5 cm at 8 m/s.
APART_S = 0.05 / 8
TICK_S = 2e-3
LIMIT_N = 2.5
STARTS_WITHIN_S, PLAYED_S = 20.0, 6.0

# What the board of the shipped scene senses.
SENSED = """
extends = "three_fingers"
[sensing.source.announce]
transit = "180 ms"
"""


@contextmanager
def three_drives(folder: Path) -> Iterator[EmulatedBench]:
    """Provide the shipped scene of three drives, on which the pulse is felt, with an ECG."""
    (sensed := folder / "sensed.toml").write_text(SENSED, encoding="utf-8")
    name = "three_fingers_bench"
    bench = EmulatedBench(folder, "tmcl", str(sensed), watchdog_ms=PATIENCE_MS, name=name)
    try:
        start(bench)
        yield bench
    finally:
        bench.kill()


def start(bench: EmulatedBench) -> None:
    """Start drives, board and nodes, with the ECG beside the films. Raises BenchFailedError."""
    text = bench.scene.read_text("utf-8")
    names = '"cun", "guan", "chi"'
    assert names in text
    bench.scene.write_text(text.replace(names, f'{names}, "announce"'), encoding="utf-8")
    bench.start_board()
    for contactor in CONTACTORS:
        bench.start_drive(contactor)
    files = [f"{kind}-{each}" for kind in ("drive", "film") for each in CONTACTORS]
    there = [bench.folder / file for file in (*files, "board")]
    until(lambda: all(file.exists() for file in there), STARTS_WITHIN_S)
    bench.start_sensing()
    bench.start_display()
    bench.await_state("playing")


def delay_s(earlier: MotorTrace, later: MotorTrace) -> float:
    """Return by how much one force is behind the other, by their best correlation."""
    begin_ns = max(trace.time_ns[np.argmax(trace.force_n > 0.1)] for trace in (earlier, later))
    at_ns = begin_ns + 500_000_000 + np.arange(3_000) * 1_000_000
    first, second = (np.interp(at_ns, t.time_ns, t.force_n) for t in (earlier, later))
    first, second = first - first.mean(), second - second.mean()
    lags = np.arange(-20, 21)
    products = [float(first[50:-50] @ np.roll(second, -lag)[50:-50]) for lag in lags]
    best = int(np.argmax(products[1:-1])) + 1
    before, peak, after = products[best - 1 : best + 2]
    return 1e-3 * (lags[best] + 0.5 * (before - after) / (before - 2 * peak + after))


def require_apart(bench: EmulatedBench, order: tuple[str, ...], apart_s: float) -> None:
    """Raise BenchFailedError where forces are not each `apart_s` behind the next, to a tick.

    On a busy machine commands and emulated drives are late by more; a lasting skew fails each try.
    """
    motors = [bench.motor(name) for name in order]
    for later, earlier in pairwise(motors):
        if abs(skew_s := delay_s(earlier, later) - apart_s) >= TICK_S:
            raise BenchFailedError(f"the contactors are {1e3 * skew_s:.1f} ms out of step")


def test_three_drives_press_within_a_tick_of_each_other_withdraw_together_and_find_the_ecg(
    tmp_path: Path,
) -> None:
    def happens(bench: EmulatedBench) -> None:
        time.sleep(PLAYED_S)
        summary = bench.end()
        if summary["faults"]:
            raise BenchFailedError(summary["faults"])
        assert tuple(summary["contactors"]) == CONTACTORS
        for figures in summary["contactors"].values():
            assert figures["beats"]["count"] > 3
            assert figures["force_rmse_n"]["aligned"] < 0.1
            assert finger_in(figures).withdrawn
        assert summary["announce"]["r_waves"] > 3
        require_apart(bench, CONTACTORS, APART_S / 2)

    bench = on_bench(tmp_path, three_drives, happens)
    for motor in (bench.motor(name) for name in CONTACTORS):
        assert 0.05 < motor.force_n.max() <= LIMIT_N
        assert motor.force_n[-1] == 0


def test_a_fault_of_one_drive_withdraws_both_tips(tmp_path: Path) -> None:
    """The tips of the two drives that still answer."""

    def happens(bench: EmulatedBench) -> None:
        bench.processes["drive-chi"].kill()
        until(lambda: bench.await_state("fault")["faults"] != [], STARTS_WITHIN_S)
        summary = bench.await_state("fault")
        assert faults_of(summary)[0].contactor == "chi"

        def withdrawn() -> bool:
            contactors = bench.await_state("fault")["contactors"]
            return all(finger_in(contactors[name]).withdrawn for name in ("cun", "guan"))

        until(withdrawn)

    bench = on_bench(tmp_path, three_drives, happens)
    for motor in map(bench.motor, ("cun", "guan")):
        assert motor.force_n.max() > 0.05
        assert motor.force_n[-1] == 0
