"""Faults of the host on the bench for a class: real nodes, and its sketch on a simulated chip.

What the board finds by itself is in `test_board.py`. Times are the chip's own. A machine that is
too busy for a chip in real time starts the bench again, and skips the test in the end. `python -m
benchmarks class_bench` prints the times.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
import pytest

from display_node.verdict import LATE_TICKS
from tests.support import simavr
from tests.support.class_bench import (
    FAULTS,
    FOUND_AT_ONCE,
    BusyMachineError,
    ChipTrace,
    left_after_s,
    playing,
)
from tests.support.emulated_bench import BenchFailedError
from tests.support.simavr import Programs

pytestmark = pytest.mark.skipif(simavr.missing() is not None, reason=str(simavr.missing()))

LEFT_WITHIN_S = 0.3
TRIES = 4
# Ten beats, of which the playout delay takes the first to settle.
PLAYED = 8_000
LAST_BEATS_MS = 3_000
Result = TypeVar("Result")


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Programs:
    """Compile harness and sketch."""
    return Programs.compile(tmp_path_factory.mktemp("board"))


def on_a_bench(folder: Path, happens: Callable[[Path], Result]) -> Result:
    """Return the result of what happens on a bench, begun again where the bench failed before."""
    busy = ""
    for attempt in range(TRIES):
        (here := folder / str(attempt)).mkdir()
        try:
            return happens(here)
        except BusyMachineError as error:
            busy = str(error)
        except BenchFailedError as error:
            why = str(error)
    if busy:
        pytest.skip(busy)
    pytest.fail(f"the pulse was not felt in {TRIES} attempts: {why}")


@pytest.mark.parametrize("name", [name for name in FAULTS if name not in FOUND_AT_ONCE])
def test_the_board_takes_the_tip_off_the_finger(
    name: str, programs: Programs, tmp_path: Path
) -> None:
    once = partial(left_after_s, programs, FAULTS[name])
    assert on_a_bench(tmp_path, once) < LEFT_WITHIN_S


def test_the_pulse_is_felt_without_a_lost_step(programs: Programs, tmp_path: Path) -> None:
    def happens(folder: Path) -> tuple[ChipTrace, int]:
        with playing(folder, programs) as bench:
            bench.await_state("playing", played=PLAYED)
            lost_steps = bench.timely_report()["lost_steps"]
            summary = bench.end()
            trace = bench.end_chip()
            if summary["faults"]:
                raise BenchFailedError(summary["faults"])
            if (missed := summary["loop"]["worst_5s"]["missed"]) > LATE_TICKS:
                raise BusyMachineError(f"this machine missed {missed:.1%} of the ticks in 5 s")
            assert summary["beats"]["height_n"] == pytest.approx(0.3, rel=0.1)
            return trace, lost_steps

    trace, lost_steps = on_a_bench(tmp_path, happens)
    assert lost_steps == 0
    felt_n = trace.force_n[trace.force_n > 0][-2 * LAST_BEATS_MS : -LAST_BEATS_MS]
    # A height of 0.3 N on a preload that a breath changes by some 80 mN.
    assert 0.28 < np.ptp(felt_n) < 0.42
    # In the end, `SIGTERM` has taken the tip off.
    assert trace.force_n[-1] == 0
