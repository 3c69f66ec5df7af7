"""The network between the nodes cut and mended, with real TCP over emulated links."""

import random
import time
from pathlib import Path

import pytest

from benchmarks.faults.cuts import DATA, Cut, cut_runner
from benchmarks.faults.finger import Finger
from benchmarks.faults.stage import staged, unaccounted
from telepulse.netem import emulate
from telepulse.simulation.link_model import parse_link
from tests.support.felt_force import (
    BACK_WITHIN_S,
    PATIENCE_S,
    TRIES,
    assert_back_within_a_second,
    assert_limits_kept,
)
from tests.support.tcp import needs_emulator

WHOLE = parse_link("delay=20ms,jitter=3ms")
CUT = parse_link("loss=100%")
# Shorter than a display's patience with a silent network, and longer.
CUTS_S = ((0.3, 0.45), (2.05, 2.25))


@needs_emulator
def test_after_a_cut_the_pulse_is_felt_again_and_what_was_cut_is_lost(tmp_path: Path) -> None:
    rng = random.Random(3)
    with emulate(WHOLE) as link, staged(tmp_path, link) as stage:
        sensing, display, finger = stage.play()
        for shortest_s, longest_s in CUTS_S:

            def cut(shortest_s: float = shortest_s, longest_s: float = longest_s) -> int:
                time.sleep(rng.uniform(0, 0.3))
                link.change(CUT)
                cut_ns = time.monotonic_ns()
                time.sleep(rng.uniform(shortest_s, longest_s))
                assert finger.unfelt_from_ns(cut_ns, PATIENCE_S) is not None
                link.change(WHOLE)
                return time.monotonic_ns()

            assert_back_within_a_second(finger, cut)
        sent, account = sensing.end(), display.account()
    assert unaccounted(sent, account) == 0
    assert account.samples.lost
    assert account.faults == []
    assert_limits_kept(finger)


@needs_emulator
def test_after_a_cut_of_the_data_port_alone_tcp_is_not_waited_for(tmp_path: Path) -> None:
    # TCP repeats what was lost some 1.3 s after the end of such a cut, and until 2 s the display
    # had no reason of its own to connect anew.
    cut = Cut([([DATA], ((1.0, 1.2),))])
    with cut_runner(tmp_path, seed=5) as runner:
        backs_ms: list[float] = []
        while not backs_ms or backs_ms[-1] > 1e3 * BACK_WITHIN_S:
            assert len(backs_ms) < TRIES, f"felt again only {backs_ms} ms after the cut's end"
            backs_ms.append(runner.run(cut).back_ms)
        runner.sensing.end()
        account = runner.display.account()
    assert account.reconnections.opened
    assert account.reconnections.kept
    assert account.rejected == {}
    assert account.faults == []


@needs_emulator
def test_a_display_that_is_started_in_a_cut_feels_it_soon_after(tmp_path: Path) -> None:
    rng = random.Random(4)
    with emulate(WHOLE) as link, staged(tmp_path, link) as stage:
        sensing, display, finger = stage.play()

        def cut() -> int:
            nonlocal display
            link.change(CUT)
            display.kill()
            display = stage.display()
            time.sleep(rng.uniform(1.0, 2.0))
            link.change(WHOLE)
            return time.monotonic_ns()

        assert_back_within_a_second(finger, cut)
        # A whole beat.
        stage.await_played(finger, 1_000)
        sent, account = sensing.end(), display.account()
    assert unaccounted(sent, account) == 0
    assert account.faults == []
    assert_limits_kept(finger)


@needs_emulator
@pytest.mark.parametrize(
    "turns",
    [
        ["cut", "stop", 1.5, "mend", "go"],
        # The request for the next clock reply is then answered, and TCP does not repeat the data
        # for seconds.
        ["stop", 0.1, "cut", 2.5, "mend", 0.2, "go"],
    ],
    ids=["in the cut", "before the cut"],
)
def test_a_display_that_was_stopped_feels_it_soon_after(
    tmp_path: Path, turns: list[str | float]
) -> None:
    with emulate(WHOLE) as link, staged(tmp_path, link) as stage:
        sensing, display, finger = stage.play()
        does = {
            "cut": lambda: link.change(CUT),
            "mend": lambda: link.change(WHOLE),
            "stop": display.pause,
            "go": display.resume,
        }

        def cut() -> int:
            for turn in turns:
                if isinstance(turn, str):
                    does[turn]()
                else:
                    time.sleep(turn)
            return time.monotonic_ns()

        assert_back_within_a_second(finger, cut)
        stage.await_played(finger, 1_000)
        sent, account = sensing.end(), display.account()
    assert unaccounted(sent, account) == 0
    # Which of the two it is depends on whether TCP still repeated it.
    assert account.samples.lost + account.samples.late > 1_000
    assert account.faults == []
    assert_limits_kept(finger)


def await_first_copies(finger: Finger, address: str) -> None:
    """Until frames come first over this address, again."""
    counts: list[int] = []
    end_s = time.monotonic() + PATIENCE_S
    while not counts or counts[-1] < counts[0] + 20:
        assert time.monotonic() < end_s
        assert finger.status is not None
        counts.append(finger.status.summary["frames"]["first"][address])
        time.sleep(0.05)


@needs_emulator
def test_of_two_networks_one_is_enough(tmp_path: Path) -> None:
    with emulate(WHOLE, WHOLE) as link, staged(tmp_path, link) as stage:
        sensing, display, finger = stage.play()
        for number, address in enumerate(stage.connect):
            link.change(CUT, number)
            time.sleep(0.5)
            link.change(WHOLE, number)
            # The other one is cut next.
            await_first_copies(finger, address)
        sent, account = sensing.end(), display.account()
    assert unaccounted(sent, account) == 0
    assert account.samples.lost == 0
    assert len(account.frames.first) == 2
    assert min(account.frames.first.values()) > 0
    assert account.rejected == {}
    assert_limits_kept(finger)
