"""Random stalls of the display's process, on a bench in virtual time."""

import pytest

from telepulse.emulators.motor import MotorState
from tests.support.fault_runs import KINDS, TOUCH_N, bench_scene, paper_pulse
from tests.support.sender import MS
from tests.support.stall_runs import MOST_READINGS, StallRun
from tests.support.threaded_bench import ThreadedBench

# `make bench ARGS="stalls --case random"` runs hours.
SECONDS = 30.0


@pytest.mark.parametrize(("kind", "seed"), [("tmcl", 2), ("cia402", 1), ("stepdir", 1)])
@pytest.mark.parametrize("with_film", [True, False], ids=["film", "no film"])
def test_no_stall_leaves_the_tip_pressed(kind: str, with_film: bool, seed: int) -> None:
    counts = StallRun(kind, with_film, seed).run(SECONDS)
    assert counts.episodes.total() >= 3
    assert counts.withdrawn.total() >= 1
    assert counts.examples == []
    # The pulse has 0.55 N; during a stall the last command stays in effect.
    assert counts.most_n < 1.25 * 0.55 + 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_a_loop_stalled_anywhere_in_a_tick_leaves_the_withdrawal_to_the_drives_thread(
    kind: str,
) -> None:
    """The stall may begin while the loop holds the lock that both threads use."""
    pressed_ns = 0

    def watch(moment: MotorState) -> None:
        nonlocal pressed_ns
        if moment.force_n > TOUCH_N:
            pressed_ns = moment.time_ns

    def stall() -> None:
        loop = [thread for thread in bench.threads if thread.name == "loop"]
        bench.world.stall(loop, bench.world.now_ns + 1_000 * MS)

    with ThreadedBench(bench_scene(kind), paper_pulse(), True, watch) as bench:
        for readings in range(1, MOST_READINGS + 1):
            bench.start()
            bench.run(700)
            assert bench.world.now_ns - pressed_ns < 100 * MS, "no pulse to withdraw from"
            bench.world.interrupt(readings, stall)
            bench.run(900)
            assert bench.world.now_ns - pressed_ns > 400 * MS, f"pressed after reading {readings}"
            bench.run(200)
            assert bench.faults
            bench.stop()
