"""Contactors on emulated drives, each a process: one instant, one safety."""

import time
from collections.abc import Callable
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from tests.support.emulated_bench import BenchFailedError, EmulatedBench, MotorTrace
from tests.support.waiting import until

CONTACTORS = ("cun", "chi")
THREE = ("cun", "guan", "chi")
# The pulse wave takes 5 cm at 8 m/s.
APART_S = 0.05 / 8
TICK_S = 2e-3
LIMIT_N = 2.5
TRIES = 4
PATIENCE_MS = 400
STARTS_WITHIN_S, PLAYED_S = 20.0, 6.0

SCENE = """
[sensing.source]
kind = "synthetic"
preset = "wide"
peak_to_peak = "0.3 N"
[[sensing.source.position]]
name = "cun"
distance = "5 cm"
[[sensing.source.position]]
name = "chi"
"""
CONTACTOR = """
[[display.contactor]]
channel = "{name}"
drive.port = "{folder}/drive-{name}"
feedback.port = "{folder}/film-{name}"
"""

# What the board of the shipped scene senses.
SENSED = """
extends = "three_fingers"
[sensing.source.announce]
transit = "180 ms"
"""


def start(folder: Path) -> EmulatedBench:
    """Start two drives and both nodes. Raises BenchFailedError."""
    bench = EmulatedBench(folder, "tmcl", watchdog_ms=PATIENCE_MS)
    own = folder / "own.toml"
    bench.scene.rename(folder / "bench.toml")
    tables = "".join(CONTACTOR.format(name=name, folder=folder) for name in CONTACTORS)
    own.write_text(f'extends = "{folder}/bench.toml"\n{SCENE}{tables}', encoding="utf-8")
    bench.scene = own
    start_nodes(bench, CONTACTORS)
    return bench


def start_shipped(folder: Path) -> EmulatedBench:
    """Start the shipped scene of three drives, with an ECG beside the films of the board."""
    (sensed := folder / "sensed.toml").write_text(SENSED, encoding="utf-8")
    name = "three_fingers_bench"
    bench = EmulatedBench(folder, "tmcl", str(sensed), watchdog_ms=PATIENCE_MS, name=name)
    text = bench.scene.read_text("utf-8")
    names = '"cun", "guan", "chi"'
    assert names in text
    bench.scene.write_text(text.replace(names, f'{names}, "announce"'), encoding="utf-8")
    bench.start_board()
    start_nodes(bench, THREE, "board")
    return bench


def start_nodes(bench: EmulatedBench, contactors: tuple[str, ...], *files: str) -> None:
    """Start the drives and both nodes, once the drives' files and `files` exist."""
    for name in contactors:
        bench.start_drive(name)
    awaited = [f"{kind}-{name}" for kind in ("drive", "film") for name in contactors]
    there = [bench.folder / name for name in (*awaited, *files)]
    until(lambda: all(file.exists() for file in there), STARTS_WITHIN_S)
    bench.start_sensing()
    bench.start_display()
    bench.await_state("playing")


def on_drives(
    folder: Path,
    happens: Callable[[EmulatedBench], None],
    start: Callable[[Path], EmulatedBench] = start,
) -> EmulatedBench:
    """Return a bench, ended, on which `happens` was called; on a busy machine it may fail."""
    for attempt in range(TRIES):
        (here := folder / str(attempt)).mkdir()
        with ExitStack() as leaving:
            try:
                bench = start(here)
                leaving.callback(bench.kill)
                happens(bench)
                bench.end()
                return bench
            except BenchFailedError as error:
                why = str(error)
    pytest.fail(f"the pulse was not felt in {TRIES} attempts: {why}")


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


def test_two_drives_press_within_a_tick_of_each_other_and_withdraw_together(
    tmp_path: Path,
) -> None:
    def happens(bench: EmulatedBench) -> None:
        time.sleep(PLAYED_S)
        summary = bench.end()
        if summary["faults"]:
            raise BenchFailedError(summary["faults"])
        assert tuple(summary["contactors"]) == CONTACTORS
        for figures in summary["contactors"].values():
            assert figures["force_rmse_n"]["aligned"] < 0.1
            assert figures["finger"] == "withdrawn"
        require_apart(bench, CONTACTORS, APART_S)

    bench = on_drives(tmp_path, happens)
    for motor in (bench.motor(name) for name in CONTACTORS):
        assert 0.1 < motor.force_n.max() <= LIMIT_N
        assert motor.force_n[-1] == 0


def test_the_shipped_scene_presses_three_fingers_by_drives_and_finds_the_ecg(
    tmp_path: Path,
) -> None:
    def happens(bench: EmulatedBench) -> None:
        time.sleep(PLAYED_S)
        summary = bench.end()
        if summary["faults"]:
            raise BenchFailedError(summary["faults"])
        assert tuple(summary["contactors"]) == THREE
        for figures in summary["contactors"].values():
            assert figures["beats"]["count"] > 3
            assert figures["finger"] == "withdrawn"
        assert summary["announce"]["r_waves"] > 3
        require_apart(bench, THREE, APART_S / 2)

    bench = on_drives(tmp_path, happens, start_shipped)
    for motor in (bench.motor(name) for name in THREE):
        assert 0.05 < motor.force_n.max() <= LIMIT_N
        assert motor.force_n[-1] == 0


def test_a_fault_of_one_drive_withdraws_both_tips(tmp_path: Path) -> None:
    def happens(bench: EmulatedBench) -> None:
        bench.processes["drive-chi"].kill()
        until(lambda: bench.await_state("fault")["faults"] != [], STARTS_WITHIN_S)
        summary = bench.await_state("fault")
        assert summary["faults"][0].startswith("chi: ")
        finger = "withdrawn"
        until(lambda: bench.await_state("fault")["contactors"]["cun"]["finger"] == finger)

    motor = on_drives(tmp_path, happens).motor("cun")
    assert motor.force_n.max() > 0.1
    assert motor.force_n[-1] == 0
