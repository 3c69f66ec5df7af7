"""The display's process is stalled at random, on a bench in virtual time."""

import pytest

from benchmarks.lies import KINDS, TOUCH_N, bench_scene, paper_pulse
from benchmarks.random_stalls import MOST_LOOKS, Ordeal
from benchmarks.virtual_bench import MS, VirtualBench
from telepulse.emulators.motor import MotorState

# Hours of it: `make bench ARGS=random_stalls`.
SECONDS = 30.0


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("with_film", [True, False], ids=["film", "no film"])
def test_no_stall_leaves_the_tip_pressed(with_film: bool, seed: int) -> None:
    tally = Ordeal(KINDS[seed % 2], with_film, seed).run(SECONDS)
    assert tally.episodes.total() >= 3
    assert tally.withdrawn.total() >= 1
    assert tally.examples == []
    # A pulse of 0.55 N; a stall holds the last command.
    assert tally.most_n < 1.25 * 0.55 + 0.1


@pytest.mark.parametrize("kind", KINDS)
def test_a_loop_that_stands_still_anywhere_in_a_tick_leaves_the_withdrawal_to_the_drives_thread(
    kind: str,
) -> None:
    """While it holds the lock that both use, too."""
    pressed_ns = 0

    def watch(moment: MotorState) -> None:
        nonlocal pressed_ns
        if moment.force_n > TOUCH_N:
            pressed_ns = moment.time_ns

    def stall() -> None:
        loop = [thread for thread in bench.threads if thread.name == "loop"]
        bench.world.stall(loop, bench.world.now_ns + 1_000 * MS)

    with VirtualBench(bench_scene(kind), paper_pulse(), True, watch) as bench:
        for looks in range(1, MOST_LOOKS + 1):
            bench.start()
            bench.run(700)
            assert bench.world.now_ns - pressed_ns < 100 * MS, "no pulse to withdraw from"
            bench.world.interrupt(looks, stall)
            bench.run(900)
            assert bench.world.now_ns - pressed_ns > 400 * MS, f"pressed after look {looks}"
            bench.run(200)
            assert bench.faults
            bench.stop()
