import math

import numpy as np
import pytest

from display_node.prediction import PredictorName, build_predictor
from display_node.prediction.ensemble import Ensemble, Stack
from display_node.prediction.experts import AHEAD, FURTHEST
from tests.support.pulse_signals import MS, T0_NS, Floats, beats, feed

STEPS = 4_000
TRUTH = np.cumsum(np.random.default_rng(1).standard_normal(STEPS + FURTHEST)) * 0.1


def run(stack: Stack, gains: tuple[float, ...], noise: float, seed: int = 2) -> np.ndarray:
    """Experts that see the future times a gain, with noise; last RMSE, a row an expert."""
    rng = np.random.default_rng(seed)
    squares = np.zeros((len(gains) + 1, len(AHEAD)))
    for step in range(STEPS):
        newest = TRUTH[step]
        coming = TRUTH[step + AHEAD] - newest
        rows = np.array([gain * coming + noise * rng.standard_normal(len(AHEAD)) for gain in gains])
        stacked = stack.predict(newest, rows)
        stack.learn(newest)
        if step >= STEPS // 2:
            squares += (np.vstack([rows, stacked]) - coming) ** 2
    return np.sqrt(squares / (STEPS - STEPS // 2))


def test_it_is_better_than_the_best_of_its_experts() -> None:
    rms = run(Stack(np.array([0.5, 0.5])), gains=(0.7, 1.2), noise=0.2)
    assert (rms[-1] < 0.95 * rms[:-1].min(axis=0)).all()


def test_it_undoes_what_an_expert_always_gets_wrong() -> None:
    rms = run(Stack(np.array([1.0])), gains=(0.5,), noise=0.0)
    assert (rms[-1] < 0.02 * rms[0]).all()


def test_it_begins_with_the_trust_it_is_given() -> None:
    rows = np.vstack([np.full(len(AHEAD), 1.0), np.full(len(AHEAD), 10.0)])
    stacked = Stack(np.array([0.4, 0.2])).predict(0.0, rows)
    np.testing.assert_allclose(stacked, 2.4)


def test_its_own_error_estimate_is_its_error() -> None:
    stack = Stack(np.array([1.0]))
    assert stack.rms(0) is None
    rms = run(stack, gains=(1.0,), noise=0.2)
    for horizon in (0, len(AHEAD) - 1):
        assert stack.rms(horizon) == pytest.approx(rms[-1][horizon], rel=0.1)


def test_an_expert_that_was_long_silent_does_not_upset_it(monkeypatch: pytest.MonkeyPatch) -> None:
    # 8000 steps of so short a memory are as a day of the usual one.
    monkeypatch.setattr("display_node.prediction.ensemble.FORGET", 0.9)
    stack, rng = Stack(np.array([1.0, 0.0])), np.random.default_rng(3)
    for step in range(8_000):
        coming = rng.standard_normal(len(AHEAD))
        stack.predict(0.0, np.vstack([coming, np.zeros(len(AHEAD))]))
        stack.learn(float(np.sin(step)))
    for _ in range(2 * FURTHEST):
        woken = stack.predict(0.0, np.ones((2, len(AHEAD))))
        stack.learn(0.5)
    assert np.abs(woken - 0.5).max() < 0.1


LEARNT: tuple[PredictorName, ...] = ("fir", "analogue", "harmonic", "stack")
T_S = np.arange(16_000) * 0.001
FORCE_N = 0.3 + 0.1 * beats(T_S)


def ahead(predictor: Ensemble, samples: int, horizon_ms: int, first: int = 0) -> float:
    """What is predicted so far after the last of some samples."""
    return predictor.predict(T0_NS + (first + samples - 1 + horizon_ms) * MS)


def errors_n(predictor: Ensemble, force_n: Floats, start: int, horizon_ms: int) -> Floats:
    """Feeds all, and predicts from each frame after `start`."""
    feed(predictor, force_n[:start])
    found = []
    for first in range(start, len(force_n) - horizon_ms - 5, 5):
        feed(predictor, force_n[first : first + 5], first)
        truth = force_n[first + 4 + horizon_ms]
        found.append(ahead(predictor, 5, horizon_ms, first) - truth)
    return np.array(found)


@pytest.mark.parametrize("name", LEARNT)
def test_it_learns_a_pulse(name: PredictorName) -> None:
    late = errors_n(Ensemble(name, MS), FORCE_N, 12_000, 100)
    assert np.sqrt(np.mean(late**2)) < 0.1 * FORCE_N.std()


@pytest.mark.parametrize("horizon_ms", [20, 200])
def test_the_stack_is_as_good_as_the_best_within_a_margin(horizon_ms: int) -> None:
    noisy_n = FORCE_N + 1e-3 * np.random.default_rng(1).standard_normal(len(FORCE_N))
    stack, squares = Ensemble("stack", MS), []
    for first in range(0, len(noisy_n) - 5, 5):
        feed(stack, noisy_n[first : first + 5], first)
        at = first + 4 + horizon_ms
        if first > 12_000 and at < len(noisy_n):
            found = stack.predict_each(T0_NS + at * MS)
            squares.append((np.array(found) - FORCE_N[at]) ** 2)
    *experts, best = np.sqrt(np.mean(squares, axis=0)).tolist()
    assert best < 1.2 * min(experts) + 0.03 * FORCE_N.std()


@pytest.mark.parametrize("name", LEARNT)
def test_the_future_changes_no_prediction(name: PredictorName) -> None:
    other_n = FORCE_N.copy()
    other_n[6_000:] += 1.0
    one, other = Ensemble(name, MS), Ensemble(name, MS)
    differ = False
    for first in range(0, 6_050, 5):
        feed(one, FORCE_N[first : first + 5], first)
        feed(other, other_n[first : first + 5], first)
        same = ahead(one, 5, 60, first) == ahead(other, 5, 60, first)
        assert same or first >= 6_000
        differ |= not same
    assert differ


@pytest.mark.parametrize("name", LEARNT)
def test_it_holds_until_it_has_learnt(name: PredictorName) -> None:
    predictor = Ensemble(name, MS)
    assert predictor.predict(T0_NS) == 0.0
    for first in range(0, 1_500, 5):
        feed(predictor, FORCE_N[first : first + 5], first)
        assert ahead(predictor, 5, 50, first) == FORCE_N[first + 4]
    assert predictor.error_n(50 * MS) is None


@pytest.mark.parametrize("name", LEARNT)
def test_a_constant_stays_constant_and_enormous_samples_are_got_over(name: PredictorName) -> None:
    predictor = Ensemble(name, MS)
    feed(predictor, np.full(4_000, 0.3))
    assert ahead(predictor, 4_000, 100) == pytest.approx(0.3, abs=1e-6)
    predictor, force_n = Ensemble(name, MS), FORCE_N.copy()
    force_n[3_000:3_050] = [1.7e308, -1.7e308] * 25
    feed(predictor, force_n[:9_000])
    assert math.isfinite(ahead(predictor, 9_000, 50))
    assert abs(ahead(predictor, 9_000, 50)) < 1e308


def test_predictions_are_smooth_from_tick_to_tick() -> None:
    predictor = Ensemble("stack", MS)
    feed(predictor, FORCE_N[:12_000])
    path = [ahead(predictor, 12_000, ahead_ms) for ahead_ms in range(1, 250)]
    assert np.abs(np.diff(path, 2)).max() < 4 * np.abs(np.diff(FORCE_N, 2)).max()
    assert ahead(predictor, 12_000, 400) == ahead(predictor, 12_000, 10_000)


def test_late_samples_make_it_better() -> None:
    """A peak of 60 ms never comes, comes late, or comes in time."""
    gap = slice(12_100, 12_160)
    never, late, whole = (Ensemble("fir", MS) for _ in range(3))
    for predictor in (never, late, whole):
        feed(predictor, FORCE_N[: gap.start])
        if predictor is whole:
            feed(predictor, FORCE_N[gap], gap.start)
        feed(predictor, FORCE_N[gap.stop : gap.stop + 5], gap.stop)
        for _ in range(60):
            predictor.work()
        if predictor is late:
            times_ns = [T0_NS + n * MS for n in range(gap.start, gap.stop)]
            predictor.observe(times_ns, FORCE_N[gap].tolist())
        feed(predictor, FORCE_N[gap.stop + 5 : gap.stop + 10], gap.stop + 5)
    paths = [
        np.array([ahead(predictor, 10, ahead_ms, gap.stop) for ahead_ms in range(10, 200)])
        for predictor in (never, late, whole)
    ]
    without, mended, best = paths
    assert np.abs(mended - best).max() < 0.5 * np.abs(without - best).max()


@pytest.mark.parametrize(("period_ns", "frame"), [(250_000, 20), (8_333_333, 1), (10 * MS, 2)])
def test_any_rate_will_do(period_ns: int, frame: int) -> None:
    predictor, t_s = Ensemble("stack", max(period_ns, MS)), np.arange(0, 14, period_ns * 1e-9)
    force_n = 0.3 + 0.1 * beats(t_s)
    feed(predictor, force_n, period_ns=period_ns, frame=frame)
    newest = len(force_n) // frame * frame - 1
    at_s = t_s[newest] + np.arange(0.02, 0.2, 0.01)
    found = [predictor.predict(T0_NS + round(instant_s * 1e9)) for instant_s in at_s]
    np.testing.assert_allclose(found, 0.3 + 0.1 * beats(at_s), atol=0.03)


def test_an_outage_is_got_over() -> None:
    predictor = Ensemble("stack", MS)
    feed(predictor, FORCE_N[:9_000])
    feed(predictor, FORCE_N[10_000:15_000], 10_000)
    late = [ahead(predictor, 5_000, ms, 10_000) - FORCE_N[14_999 + ms] for ms in range(20, 200)]
    assert np.sqrt(np.mean(np.square(late))) < 0.3 * FORCE_N.std()


def test_its_expected_error_is_its_error() -> None:
    noisy_n = FORCE_N + 2e-3 * np.random.default_rng(1).standard_normal(len(FORCE_N))
    predictor = Ensemble("stack", MS)
    actual_n = np.sqrt(np.mean(errors_n(predictor, noisy_n, 12_000, 100) ** 2))
    assert predictor.error_n(100 * MS) == pytest.approx(actual_n, rel=0.5)
    assert (predictor.error_n(240 * MS) or 0) > 0
    # It predicts no further than 250 ms.
    assert predictor.error_n(260 * MS) is None


def test_a_new_cell_takes_effect_from_the_second_tick_on() -> None:
    predictor, samples = Ensemble("stack", MS), 10_000
    feed(predictor, FORCE_N[:samples])
    times_ns = [T0_NS + (samples + number) * MS for number in range(5)]
    predictor.observe(times_ns, FORCE_N[samples : samples + 5].tolist())
    found = [ahead(predictor, samples, 50)]
    for _ in range(5):
        predictor.work()
        found.append(ahead(predictor, samples, 50))
    assert found[1] == found[0] != found[2]
    assert found[2:] == found[2:3] * 4


def test_work_that_a_slow_tick_leaves_is_made_up_for() -> None:
    fast, slow = Ensemble("fir", MS), Ensemble("fir", 10 * MS)
    feed(fast, FORCE_N[:5_000])
    for first in range(0, 5_000, 10):
        times_ns = [T0_NS + (first + number) * MS for number in range(10)]
        slow.observe(times_ns, FORCE_N[first : first + 10].tolist())
        slow.work()
    for predictor in (fast, slow):
        for _ in range(10):
            predictor.work()
    assert ahead(slow, 5_000, 50) == pytest.approx(ahead(fast, 5_000, 50), abs=0.01)


def test_a_scene_names_them() -> None:
    for predictor in (build_predictor(name, MS) for name in LEARNT):
        assert isinstance(predictor, Ensemble)
        assert predictor.names[-1] == "stack"
