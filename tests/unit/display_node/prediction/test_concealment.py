import math

import numpy as np
import pytest

from display_node.prediction import build_predictors
from display_node.prediction.concealment import Blend, Concealment
from protocol.wire.messages import ChannelSamples, Frame

MS = 1_000_000
T0_NS = 1_700_000_000_000_000_000


def straight(at_ms: float, offset: float = 0.0) -> list[float]:
    return [offset + 0.01 * (at_ms + step) for step in range(4)]


def blended(blend: Blend, at_ms: float, path: list[float], newest_ms: float) -> list[float]:
    return blend.apply(path, T0_NS + round(at_ms * MS), T0_NS + round(newest_ms * MS))


@pytest.mark.parametrize("warp", [0.98, 1.0, 1.02])
def test_a_constant_prediction_is_unchanged_at_any_rate_of_playout(warp: float) -> None:
    blend = Blend(MS)
    for tick in range(100):
        path = straight(40 + warp * tick)
        assert blended(blend, 40 + warp * tick, path, 0) == pytest.approx(path, abs=1e-12)


def test_new_data_replace_the_prediction_exponentially_as_the_path_predicts() -> None:
    blend = Blend(MS)
    for at_ms in range(40, 45):
        before = blended(blend, at_ms, straight(at_ms), 0)
    # The prediction was 0.1 too low, 44 ms ahead: time constant 0.2 × 44 ms.
    paths = [blended(blend, ms, straight(ms, offset=0.1), 5) for ms in range(45, 145)]
    felt = [path[0] for path in paths]
    assert felt[0] == pytest.approx(before[1])
    assert felt[1:4] == pytest.approx(paths[0][1:4])
    missing = [0.1 + 0.01 * ms - value for ms, value in zip(range(45, 145), felt, strict=True)]
    for ticks in (1, 10, 50):
        assert missing[ticks] == pytest.approx(0.1 * math.exp(-ticks / (0.2 * 44)))


def test_an_offset_of_a_long_horizon_does_not_jump_when_short_ones_follow() -> None:
    blend = Blend(MS)
    for at_ms in range(40, 45):
        blended(blend, at_ms, straight(at_ms), 0)
    felt = [blended(blend, ms, straight(ms, offset=0.1), ms - 1)[0] for ms in range(45, 60)]
    assert 0.03 < np.diff(felt).max() < 0.045


def test_blending_ends_once_samples_arrive_on_time_again() -> None:
    blend = Blend(MS)
    for at_ms in range(10):
        blended(blend, at_ms, straight(at_ms), 0)
    assert blend.busy
    steps, before = [], 0.09
    for at_ms in range(10, 110):
        if not blend.busy:
            break
        path = straight(at_ms, offset=0.1)
        # A frame of 5 samples each 5 ms, all of them on time again.
        felt = blended(blend, at_ms, path, 20 + at_ms // 5 * 5)
        steps.append(felt[0] - before)
        before = felt[0]
    assert not blend.busy
    assert felt == path
    assert len(steps) > 5
    # The jump of 0.1 is distributed over several ticks of slope 0.01.
    assert max(steps) < 0.01 + 0.05


@pytest.mark.parametrize("at_ms", [20, 1000, -1000])
def test_paths_are_not_blended_over_missed_ticks_and_jumps(at_ms: int) -> None:
    blend = Blend(MS)
    for before_ms in range(10):
        blended(blend, before_ms, straight(before_ms), 0)
    path = straight(at_ms, offset=1.0)
    assert blended(blend, at_ms, path, 5) == path


def test_a_prediction_that_is_not_finite_leaves_no_offset() -> None:
    blend = Blend(MS)
    blended(blend, 40, straight(40), 0)
    blended(blend, 41, [math.inf] * 4, 1)
    blended(blend, 42, [math.nan] * 4, 2)
    for at_ms in range(43, 60):
        path = straight(at_ms)
        felt = blended(blend, at_ms, path, 3)
    assert felt == pytest.approx(path)


def samples(first: int, values: list[float]) -> ChannelSamples:
    """Return a sample each millisecond."""
    return Frame(1, first, first * MS, MS, np.array(values)[:, np.newaxis]).samples_of(0)


def test_received_values_stay_and_missing_ones_are_predicted_without_a_jump() -> None:
    (predictor,) = build_predictors("hold")
    concealment = Concealment(predictor, MS)
    concealment.observe(samples(0, [0.3, 0.3]))
    received_n = [0.3, 0.3]
    assert concealment.complete(received_n, 2, 0, 1 * MS) is received_n
    assert concealment.complete([0.3], 3, 1 * MS, 1 * MS) == pytest.approx([0.3] * 3)
    assert concealment.complete([], 3, 5 * MS, 1 * MS) == pytest.approx([0.3] * 3)
    concealment.observe(samples(2, [0.5] * 4))
    corrected = concealment.complete([], 3, 6 * MS, 5 * MS)
    assert corrected[0] == pytest.approx(0.3)
    assert 0.3 < corrected[1] < corrected[2] < 0.5
