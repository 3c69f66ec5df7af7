import math

import numpy as np
import pytest

from display_node.prediction import PredictorName
from display_node.prediction.concealment import (
    MOST_NS,
    Blend,
    Concealment,
    PulseSize,
    Trust,
    auto_delay_ns,
)
from protocol.wire.messages import Frame

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


def frame(first: int, values: list[float]) -> Frame:
    """Return a frame with a sample each millisecond."""
    return Frame(1, first, first * MS, MS, np.array(values)[:, np.newaxis])


@pytest.mark.parametrize(
    ("predictor", "auto", "trusted"),
    [("linear", True, None), ("hold", True, None), ("stack", False, None), ("stack", True, False)],
)
def test_only_a_predictor_with_an_error_estimate_can_be_trusted_under_auto(
    predictor: PredictorName, auto: bool, trusted: bool | None
) -> None:
    concealment = Concealment(predictor, 0, MS, auto)
    concealment.judge(5 * MS, 5 * MS)
    assert concealment.trusted is trusted


def test_received_values_stay_and_missing_ones_are_predicted_without_a_jump() -> None:
    concealment = Concealment("hold", 0, MS, auto=True)
    concealment.observe(frame(0, [0.3, 0.3]))
    received_n = [0.3, 0.3]
    assert concealment.complete(received_n, 2, 0, 1 * MS) is received_n
    assert concealment.complete([0.3], 3, 1 * MS, 1 * MS) == pytest.approx([0.3] * 3)
    assert concealment.complete([], 3, 5 * MS, 1 * MS) == pytest.approx([0.3] * 3)
    concealment.observe(frame(2, [0.5] * 4))
    corrected = concealment.complete([], 3, 6 * MS, 5 * MS)
    assert corrected[0] == pytest.approx(0.3)
    assert 0.3 < corrected[1] < corrected[2] < 0.5


SECOND_NS = 1_000 * MS
TICK_NS = 5 * MS


def judged(
    trust: Trust, from_s: float, to_s: float, error_n: float | None, size_n: float = 0.3
) -> list[bool]:
    """Return whether the predictor is trusted after each tick."""
    found = []
    for now_ns in range(round(from_s * SECOND_NS), round(to_s * SECOND_NS), TICK_NS):
        trust.judge(now_ns, error_n, size_n)
        found.append(trust.trusted)
    return found


def test_trust_is_gained_slowly_and_lost_at_once() -> None:
    trust = Trust()
    assert not any(judged(trust, 0, 15, 0.003))
    assert judged(trust, 15, 20, 0.003)[-1]
    # An error of a third of the pulse.
    lost = judged(trust, 20, 20.5, 0.1)
    assert lost.index(False) * TICK_NS <= 50 * MS
    assert not any(lost[lost.index(False) :])
    assert not any(judged(trust, 20.5, 30.5, 0.003))
    assert judged(trust, 30.5, 37, 0.003)[-1]


@pytest.mark.parametrize(
    ("error_n", "size_n"), [*((e, 0.3) for e in (None, 0.0085, math.inf)), (0.0, 0.0)]
)
def test_trust_requires_a_pulse_and_a_small_known_error(
    error_n: float | None, size_n: float
) -> None:
    assert not any(judged(Trust(), 0, 60, error_n, size_n))


def test_trust_does_not_change_between_the_two_bounds() -> None:
    distrusted, trusted = Trust(), Trust()
    judged(trusted, 0, 20, 0.003)
    assert not any(judged(distrusted, 20, 60, 0.0105))
    assert all(judged(trusted, 20, 60, 0.0105))
    # The error is unknown beyond the prediction; it is weighted by the length of the silence.
    trusted.judge(61 * SECOND_NS, None, 0.3)
    assert not trusted.trusted


@pytest.mark.parametrize(("stall_ms", "trusted"), [(20, True), (60, False)])
def test_an_error_is_weighted_by_its_duration(stall_ms: int, trusted: bool) -> None:
    trust = Trust()
    for now_ms in range(0, 40_000, 5):
        # A tenth of the pulse, twice a second.
        trust.judge(now_ms * MS, 0.03 if now_ms % 500 < stall_ms else 0.0, 0.3)
    assert trust.trusted is trusted


def observe(size: PulseSize, from_s: float, to_s: float, offset_n: float = 0.0) -> None:
    """Add a sine of 1.2 Hz, 0.3 N from foot to peak."""
    for first_ms in range(round(from_s * 1000), round(to_s * 1000), 5):
        wave = [math.sin(2 * math.pi * 1.2e-3 * (first_ms + ms)) for ms in range(5)]
        size.observe(first_ms * MS, [0.15 * value + offset_n for value in wave])


def test_the_pulses_size_is_known_after_a_window_ignores_an_artefact_and_follows_a_change() -> None:
    size = PulseSize()
    observe(size, 0, 2)
    assert size.size is None
    observe(size, 2, 2.1)
    assert size.size == pytest.approx(0.3, rel=1e-3)
    observe(size, 2.1, 11)
    observe(size, 11, 13, offset_n=2.0)
    for from_s, to_s in ((13, 14.1), (14.1, 20)):
        observe(size, from_s, to_s)
        assert size.size == pytest.approx(0.3, rel=1e-3)
    for first_ms in range(20_000, 40_000, 5):
        size.observe(first_ms * MS, [0.1 * (first_ms % 1000 < 500)])
    assert size.size == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("carried_ms", "trusted", "wanted_ms"),
    [(60, False, 60), (60, True, 0), (0, True, 0), (450, True, 50), (450, False, 450)],
)
def test_trust_reduces_e_by_400_ms_at_most(carried_ms: int, trusted: bool, wanted_ms: int) -> None:
    assert auto_delay_ns(carried_ms * MS, trusted) == wanted_ms * MS
    assert MOST_NS < 500 * MS
