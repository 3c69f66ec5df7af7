import math

import numpy as np
import pytest

from display_node.prediction.concealment import Blend
from display_node.scoring.prediction_score import KEEP_TICKS, PredictionScore
from protocol.summary.fields import Compensation
from protocol.wire.messages import Frame

MS = 1_000_000
HEIGHT_N = 0.3


def added(score: PredictionScore, played_s: float = 60.0) -> Compensation:
    return score.add_to(Compensation(predicted=0.5), played_s)


def predict(score: PredictionScore, from_ms: int, to_ms: int, force_n: float = 0.0) -> None:
    """Play a constant force in every ms from one time to another, half a ms after it."""
    for ms in range(from_ms, to_ms):
        score.add_output(ms * MS + MS // 2, force_n, 0.0, HEIGHT_N, full=True)


def frame(first_ms: int, *values: float) -> Frame:
    return Frame(1, first_ms, first_ms * MS, MS, np.array(values, "<f8")[:, np.newaxis])


def arrive(score: PredictionScore, first_ms: int, *values: float, ratio: float = 1.0) -> None:
    score.add_samples(frame(first_ms, *values).samples_of(0), ratio, HEIGHT_N)


def test_the_error_is_that_of_the_played_force_at_each_sample_that_came_later() -> None:
    score = PredictionScore(MS)
    for ms in range(10):
        # A straight line, interpolated between the ticks.
        score.add_output(ms * MS + MS // 2, 0.01 * (ms + 0.5), 0.0, HEIGHT_N, full=True)
    arrive(score, 1, 0.01 + 0.003, 0.02 - 0.004)
    found = added(score)
    assert found.error_n == pytest.approx(math.sqrt((0.003**2 + 0.004**2) / 2))
    assert found.error_share == pytest.approx(found.error_n / HEIGHT_N)
    assert found.predicted == 0.5
    # Samples at instants that were not predicted, or are still to be played, are not scored.
    arrive(score, -3, 9.0, 9.0, 9.0, 9.0)
    arrive(score, 10, 9.0, 9.0)
    assert added(score) == found
    # At the finger.
    arrive(score, 3, 0.03 + 0.005, 0.04 + 0.005, ratio=2.0)
    squares = 0.003**2 + 0.004**2 + 2 * (2 * 0.005) ** 2
    assert added(score).error_n == pytest.approx(math.sqrt(squares / 4))


def test_nothing_is_scored_across_missed_ticks_a_jump_back_or_a_new_clock() -> None:
    score = PredictionScore(MS)
    predict(score, 0, 5)
    predict(score, 10, 15)
    arrive(score, 5, *[9.0] * 5)
    predict(score, 3, 4)
    arrive(score, 11, *[9.0] * 3)
    score.restart()
    arrive(score, 3, 9.0)
    assert added(score) == Compensation(predicted=0.5)
    assert added(PredictionScore(MS), played_s=0.0) == Compensation(predicted=0.5)


def test_only_the_newest_ticks_wait_for_their_samples() -> None:
    score = PredictionScore(MS)
    predict(score, 0, 2 * KEEP_TICKS + 1)
    arrive(score, KEEP_TICKS - 10, *[9.0] * 9)
    assert added(score).error_n is None
    arrive(score, KEEP_TICKS + 1, *[0.1] * 9)
    assert added(score).error_n == pytest.approx(0.1)


@pytest.mark.parametrize(("jump", "felt"), [(0.11, 3), (0.09, 0)])
def test_each_noticeable_correction_is_counted_once(jump: float, felt: int) -> None:
    score, blend = PredictionScore(MS), Blend(MS)
    offset_n = jump * HEIGHT_N
    force_n, newest_ns = 0.0, 0
    for ms in range(1, 1000):
        if ms % 300 == 0:
            # A frame arrives 60 ms late, which changes the prediction at once, up and down.
            newest_ns, force_n = (ms - 60) * MS, offset_n - force_n
        path_n = blend.apply([force_n] * 3, ms * MS, newest_ns)
        score.add_output(ms * MS, path_n[0], blend.offset_n, HEIGHT_N, full=True)
    found = added(score, played_s=30.0)
    assert found.corrections == (felt or None)
    assert found.corrections_per_min == (2.0 * felt or None)


def test_a_correction_under_a_ramp_or_of_a_pulse_of_unknown_height_is_not_felt() -> None:
    score = PredictionScore(MS)
    steps = [
        (0.1, HEIGHT_N, False),
        (0.1, HEIGHT_N, True),
        (0.0, HEIGHT_N, True),
        (0.1, None, True),
    ]
    for ms, (offset_n, height_n, full) in enumerate(steps):
        score.add_output(ms * MS, 0.0, offset_n, height_n, full)
    assert score.corrections == 0
    score.add_output(9 * MS, 0.0, -0.1, HEIGHT_N, full=True)
    assert score.corrections == 1


def test_the_alarm_is_on_while_more_than_10_percent_of_the_last_5_s_were_wrong() -> None:
    score = PredictionScore(MS)
    alarms = []
    predict(score, 0, 4_000)
    # Wrong for 510 ms from 1 s on.
    for first_ms in range(5, 3_990, 5):
        wrong = 1_000 <= first_ms < 1_510
        arrive(score, first_ms, *[0.031 if wrong else 0.029] * 5)
        alarms.append(score.alarm)
    begun = 5 + 5 * alarms.index(True)
    assert begun == 1_500
    assert all(alarms[alarms.index(True) :])
    assert added(score).noticed_5s == pytest.approx(0.102)
    predict(score, 4_000, 6_500)
    for first_ms in range(5_500, 6_495, 5):
        arrive(score, first_ms, *[0.0] * 5)
        alarms.append(score.alarm)
    # Less than half of it is left 5 s after its middle.
    ended = 5_500 + 5 * alarms[len(range(5, 3_990, 5)) :].index(False)
    assert ended == pytest.approx(6_260, abs=10)
    assert added(score).alarm is False
    assert added(score).noticed_5s == pytest.approx(0.0, abs=0.004)
