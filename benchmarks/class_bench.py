"""The bench for a class, its sketch on a simulated chip: felt error, steps, and withdrawal.

Both nodes and the emulator of the wrist's board are processes; the finger's board is its sketch on
an ATmega328P of simavr, in real time, which takes half a core. The felt error compares the force
in the harness's record with the pulse as `benchmarks.emulated_bench` does, beside the display's
own figure. Steps are measured on the same chip without the nodes, with time on command.
"""

import math
import time
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.bench_faults import tried
from benchmarks.benchmark import Benchmark
from benchmarks.emulated_bench import LEAVING_MS, SETTLED_MS, pulse, settled_rmse_n
from tests.support import simavr
from tests.support.class_bench import (
    FAULTS,
    TICK_HZ,
    ChipTrace,
    Fault,
    given_steps,
    left_after_s,
    playing,
)
from tests.support.simavr import Programs

SECONDS = 30.0
# The last is the highest; those between fall beside the ticks of the step timer.
RATES_HZ = (100.5, 3_217.0, 9_999.0, 23_333.0, float(TICK_HZ))
FELT = ("aligned RMSE of a pulse of 300 mN", "the same, by the display", "steps lost while played")
# Shown and not judged: a bootloader keeps the motor off, and a reading of 0 N is a plausible one,
# of which only the display knows that it is wrong.
BEYOND_THE_BOARD: dict[str, Fault] = {
    "reset by DTR, a bootloader waits 1 s": lambda bench: bench.chip.tell("reset 1000"),
    "film reads 0 N, found by the display": lambda bench: bench.chip.tell("film 2.5"),
}


def main(benchmark: Benchmark) -> None:
    """Print the tables of the chosen parts. Raises ValueError without compiler or simulator."""
    if (reason := simavr.missing()) is not None:
        raise ValueError(reason)
    with TemporaryDirectory(prefix="telepulse-") as folder:
        programs = Programs.compile(Path(folder))
        parts = {part.__name__: partial(part, programs) for part in (felt, steps, faults)}
        benchmark.run_parts(parts)


def felt(programs: Programs, benchmark: Benchmark) -> None:
    """Judge the felt error of a run, and the steps lost in it."""
    scored_s = 2.0 if benchmark.quick else SECONDS
    played = tried(partial(play, programs, scored_s + (SETTLED_MS + LEAVING_MS) * 1e-3))
    figures = (math.nan,) * len(FELT)
    if played is not None:
        trace, summary, lost_steps = played
        aligned_n = summary["force_rmse_n"]["aligned"] or math.nan
        figures = settled_rmse_n(trace.force_n, pulse()), aligned_n, lost_steps
    for name, figure in zip(FELT, figures, strict=True):
        benchmark.judge(name, figure)


def play(programs: Programs, seconds: float, folder: Path) -> tuple[ChipTrace, dict[str, Any], int]:
    """Return the harness's record of a run, the display's summary, and the steps lost."""
    with playing(folder, programs, with_board=True) as bench:
        bench.await_state("playing")
        time.sleep(seconds)
        bench.await_state("playing")
        lost_steps = bench.timely_report()["lost_steps"]
        summary = bench.end()
        return bench.end_chip(), summary, lost_steps


def steps(programs: Programs, benchmark: Benchmark) -> None:
    """Judge jitter and highest rate of the steps, there and back at several rates."""
    with TemporaryDirectory(prefix="telepulse-") as folder:
        found = {rate: given_steps(programs, rate, Path(folder)) for rate in RATES_HZ}
    benchmark.table(
        "Steps at a constant rate, there and back",
        ("commanded /s", "given /s", "jitter, most µs", "lost steps"),
        [
            (f"{rate:g}", f"{given:.1f}", f"{jitter_s * 1e6:.1f}", f"{lost}")
            for rate, (given, jitter_s, lost) in found.items()
        ],
    )
    kept = [given for given, _, lost in found.values() if not lost]
    benchmark.judge("step jitter", max(jitter_s for _, jitter_s, _ in found.values()))
    benchmark.judge("highest step rate without a lost step", max(kept, default=0.0))


def faults(programs: Programs, benchmark: Benchmark) -> None:
    """Judge the time from each fault until the tip is off the finger, by the chip's time."""
    judged = list(FAULTS)[: 1 if benchmark.quick else None]
    cases = {name: FAULTS[name] for name in judged} | ({} if benchmark.quick else BEYOND_THE_BOARD)
    tries = {name: tried(partial(left_after_s, programs, fault)) for name, fault in cases.items()}
    # None counts as not a number, which holds no criterion.
    found = {name: np.float64(left_s) for name, left_s in tries.items()}
    benchmark.table(
        "From a fault until the tip is off the finger",
        ("fault", "ms"),
        [(name, f"{left_s * 1e3:.0f}") for name, left_s in found.items()],
    )
    benchmark.judge("time to withdraw after kill -9", found[judged[0]])
    benchmark.judge("time to withdraw after any fault", np.max([found[name] for name in judged]))
