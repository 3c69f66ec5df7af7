"""Either node killed as by `kill -9`, at instants drawn from a seed, and started again."""

import random
import time
from pathlib import Path

from benchmarks.faults.sequence_monitor import monitor_sequence
from benchmarks.faults.stage import staged, unaccounted
from tests.support.felt_force import PATIENCE_S, assert_back_within_a_second, assert_limits_kept

KILLS = 2
# What one listener may have of a killed node's last words, and another not.
LAST_WORDS = 10


def test_a_killed_sensing_node_is_felt_again_and_its_sessions_are_accounted_for(
    tmp_path: Path,
) -> None:
    rng, killed = random.Random(1), 0
    with staged(tmp_path) as stage, monitor_sequence(stage.connect[0]) as monitor:
        sensing, display, finger = stage.play()

        def kill() -> int:
            nonlocal sensing, killed
            time.sleep(rng.uniform(0, 0.4))
            killed, killed_ns = killed + 1, time.monotonic_ns()
            sensing.kill()
            assert finger.unfelt_from_ns(killed_ns, PATIENCE_S) is not None
            sensing = stage.sense()
            return sensing.listening_ns

        for _ in range(KILLS):
            assert_back_within_a_second(finger, kill)
        sent, account = sensing.end().samples.sent, display.account()
    samples = account.samples
    assert samples.sent is not None
    assert samples.before_joining is not None
    assert (samples.played or 0) + (samples.late or 0) + (samples.lost or 0) == samples.sent
    heard = samples.sent + samples.before_joining
    assert len(monitor.sent) == killed + 1
    assert list(monitor.sent.values())[-1] == sent
    assert abs(sum(monitor.sent.values()) - heard) <= LAST_WORDS * killed
    assert account.faults == []
    assert_limits_kept(finger)


def test_a_killed_display_feels_the_stream_that_went_on_meanwhile(tmp_path: Path) -> None:
    rng = random.Random(2)
    with staged(tmp_path) as stage:
        sensing, display, finger = stage.play()

        def kill() -> int:
            nonlocal display
            time.sleep(rng.uniform(0, 0.4))
            display.kill()
            # Its last word on the account.
            assert finger.status is not None
            last = finger.status.summary["samples"]
            assert last["sent"] == last["played"] + last["late"] + last["lost"]
            display = stage.display()
            return display.listening_ns

        assert_back_within_a_second(finger, kill)
        sent, account = sensing.end(), display.account()
    assert unaccounted(sent, account) == 0
    assert (account.samples.played or 0) > 0
    assert sent.faults == account.faults == []
    assert_limits_kept(finger)
