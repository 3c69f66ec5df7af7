"""Steps of the monotonic clock of either host, as of one that was suspended.

The wall clock may be set as one likes: neither node looks at it.
"""

import time
from pathlib import Path

import pytest

from benchmarks.faults.finger import Finger
from benchmarks.faults.stage import Node, staged, unaccounted
from benchmarks.faults.stepped import STEP_VARIABLE
from tests.support.felt_force import assert_back_within_a_second, assert_limits_kept
from tests.support.waiting import until

SUSPENDED_S = 0.8


def _steps_seen(finger: Finger) -> int | None:
    return None if finger.status is None else finger.status.summary["clock"]["steps"]


def test_hosts_that_were_suspended_are_felt_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(STEP_VARIABLE, str(-SUSPENDED_S))
    with staged(tmp_path) as stage:
        sensing, display, finger = stage.play(stepped=True)
        steps = {"sensing": 0, "display": 0}

        def suspend(node: Node, whose: str) -> int:
            steps[whose] += 1
            node.pause()
            time.sleep(SUSPENDED_S)
            # It is handled first thing after the process goes on.
            node.step_clock()
            node.resume()
            # On the display's clock, by which is told what is felt.
            return time.monotonic_ns() - round(steps["display"] * SUSPENDED_S * 1e9)

        assert_back_within_a_second(finger, lambda: suspend(sensing, "sensing"))
        assert_back_within_a_second(finger, lambda: suspend(display, "display"))
        # The pulse goes on, late, before a step is known for one.
        until(lambda: _steps_seen(finger) == sum(steps.values()))
        sent, account = sensing.end(), display.account()
    assert unaccounted(sent, account) == 0
    assert account.clock.steps == sum(steps.values())
    assert account.faults == []
    assert_limits_kept(finger)
