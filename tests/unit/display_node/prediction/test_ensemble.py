import math

import numpy as np
import pytest

from display_node.prediction import PredictorName, build_predictors
from display_node.prediction.ensemble import Ensemble
from display_node.prediction.expert import AHEAD, FURTHEST, HORIZONS, SPACING
from display_node.prediction.history import History
from display_node.prediction.path_errors import PathErrors
from display_node.prediction.stack import Stack
from tests.support.drawn_pulses import Pulse
from tests.support.finger_pulses import finger_pulses
from tests.unit.display_node.prediction.pulse_signals import MS, T0_NS, Floats, beats, feed

STEPS = 4_000
TRUTH = np.cumsum(np.random.default_rng(1).standard_normal(STEPS + 2 * HORIZONS)) * 0.1


def predict(stack: Stack, newest: float, rows: Floats) -> Floats:
    """Return the path of one channel from the trajectories in `rows`, shape (n, 25)."""
    path = np.zeros((1, HORIZONS))
    trajectories = np.ascontiguousarray(rows[:, np.newaxis])
    stack.predict(np.array([newest]), np.full((1, 2), newest), trajectories, path)
    return path[0]


def push(history: History, value: float) -> None:
    """Let a value come, one step of learning after the one before."""
    for _ in range(SPACING):
        history.push(value)


def run(
    stack: Stack, gains: tuple[float, ...], noise: float, errors: PathErrors | None = None
) -> np.ndarray:
    """Return the last RMSE of each expert and of the stack, shape (n + 1, 25).

    Experts predict the future times a gain, with noise. errors: of the stack's paths.
    """
    rng = np.random.default_rng(2)
    squares = np.zeros((len(gains) + 1, len(AHEAD)))
    history = History(2 * FURTHEST)
    for step in range(STEPS):
        newest = TRUTH[step + HORIZONS]
        push(history, newest)
        coming = TRUTH[step + HORIZONS + 1 : step + 2 * HORIZONS + 1] - newest
        rows = np.array([gain * coming + noise * rng.standard_normal(len(AHEAD)) for gain in gains])
        path = predict(stack, newest, rows)
        stacked = path - newest
        stack.learn(history)
        if errors is not None:
            errors.add(np.array([newest]), path[np.newaxis], np.ones(1))
        if step >= STEPS // 2:
            squares += (np.vstack([rows, stacked]) - coming) ** 2
    return np.sqrt(squares / (STEPS - STEPS // 2))


@pytest.mark.parametrize(
    ("gains", "noise", "share"), [((0.7, 1.2), 0.2, 0.95), ((0.5,), 0.0, 0.04)]
)
def test_a_stack_is_better_than_its_best_expert_and_corrects_a_constant_gain(
    gains: tuple[float, ...], noise: float, share: float
) -> None:
    rms = run(Stack(np.full(len(gains), 1 / len(gains))), gains, noise)
    assert (rms[-1] < share * rms[:-1].min(axis=0)).all()


def test_a_stack_starts_with_its_initial_weights() -> None:
    rows = np.vstack([np.full(len(AHEAD), 1.0), np.full(len(AHEAD), 10.0)])
    stacked = predict(Stack(np.array([0.4, 0.2])), 0.5, rows)
    np.testing.assert_allclose(stacked, 2.9)


def test_a_stacks_estimate_of_its_error_is_right() -> None:
    errors = PathErrors(1)
    assert errors.expected(0, 1.0, 100) is None
    rms = run(Stack(np.array([1.0])), gains=(1.0,), noise=0.2, errors=errors)
    expected = errors.expected(0, 1.0, 200)
    assert expected is not None
    for horizon in (1, len(AHEAD)):
        estimate = math.sqrt(expected.squares_n2[horizon - 1])
        assert estimate == pytest.approx(rms[-1][horizon - 1], rel=0.1)


def test_a_stack_combines_equal_and_enormous_trajectories() -> None:
    stack, history = Stack(np.array([0.4, 0.2])), History(2 * FURTHEST)
    for _ in range(4 * HORIZONS):
        push(history, 0.0)
        stacked = predict(stack, 0.0, np.full((2, HORIZONS), 1e30))
        stack.learn(history)
    assert np.isfinite(stacked).all()


def test_a_time_of_enormous_errors_does_not_choose_the_weights() -> None:
    """Of two experts, the worse one is less wrong at a time that neither predicts."""
    stack, rng = Stack(np.array([0.5, 0.5])), np.random.default_rng(3)
    history, squares = History(2 * FURTHEST), np.zeros(2)
    for step in range(2_000):
        newest = TRUTH[step + HORIZONS]
        coming = TRUTH[step + HORIZONS + 1 : step + 2 * HORIZONS + 1] - newest
        good = coming + 0.1 * rng.standard_normal(HORIZONS)
        worse = coming + 0.3 * rng.standard_normal(HORIZONS)
        if 1_000 <= step < 1_020:
            good += 10.0
            worse += 3.0
        push(history, newest)
        stacked = predict(stack, 0.0, np.vstack([good, worse]))
        stack.learn(history)
        if step >= 1_300:
            squares += np.mean((stacked - coming) ** 2), np.mean((good - coming) ** 2)
    assert squares[0] < 2 * squares[1]


def test_a_stack_stays_stable_when_a_long_silent_expert_predicts_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # 8000 steps with so short a memory correspond to a day with the usual one.
    monkeypatch.setattr("display_node.prediction.stack.MEMORY_STEPS", 10)
    monkeypatch.setattr("display_node.prediction.stack.RIDGE", 0.01)
    stack, rng = Stack(np.array([1.0, 0.0])), np.random.default_rng(3)
    history = History(2 * FURTHEST)
    for step in range(8_000):
        coming = rng.standard_normal(len(AHEAD))
        push(history, math.sin(step))
        predict(stack, 0.0, np.vstack([coming, np.zeros(len(AHEAD))]))
        stack.learn(history)
    rise = np.arange(1.0, HORIZONS + 1)
    for step in range(8 * HORIZONS):
        push(history, 0.5 * step)
        woken = predict(stack, 0.0, np.vstack([rise, rise]))
        stack.learn(history)
    assert np.abs(woken - 0.5 * rise).max() < 0.1


def error_of_holding(tells: bool) -> float:
    """Return the last RMSE 10 ms ahead of a stack whose only expert holds the newest value.

    tells: whether the signal at the end of the newest cell is what comes then; else it is held.
    """
    stack, history = Stack(np.array([1.0])), History(2 * FURTHEST)
    square, path = 0.0, np.zeros((1, HORIZONS))
    for step in range(STEPS):
        newest, coming = TRUTH[step + HORIZONS], TRUTH[step + HORIZONS + 1]
        push(history, newest)
        after = np.full((1, 2), coming if tells else newest)
        stack.predict(np.array([newest]), after, np.zeros((1, 1, HORIZONS)), path)
        stack.learn(history)
        if step >= STEPS // 2:
            square += (path[0, 0] - coming) ** 2
    return math.sqrt(square / (STEPS - STEPS // 2))


def test_a_stack_uses_the_newest_samples() -> None:
    assert error_of_holding(tells=True) < 0.5 * error_of_holding(tells=False)


def test_a_stack_averages_the_noise_of_its_earlier_paths() -> None:
    """An expert is right, but for noise that differs from step to step."""
    rng, stack, history = np.random.default_rng(2), Stack(np.array([1.0])), History(2 * FURTHEST)
    squares = np.zeros((2, HORIZONS))
    for step in range(STEPS):
        newest = TRUTH[step + HORIZONS]
        push(history, newest)
        coming = TRUTH[step + HORIZONS + 1 : step + 2 * HORIZONS + 1] - newest
        row = coming + 0.05 * rng.standard_normal()
        # At each cell, of which two are a step of learning.
        for _ in range(SPACING):
            stacked = predict(stack, newest, row[np.newaxis]) - newest
        stack.learn(history)
        if step >= STEPS // 2:
            squares += (stacked - coming) ** 2, (row - coming) ** 2
    # No share of the newest trajectory alone leaves less than 0.98 of its error.
    assert squares[0, 10] < 0.4 * squares[1, 10]


LEARNT: tuple[PredictorName, ...] = ("fir", "analogue", "stack")
T_S = np.arange(16_000) * 0.001
FORCE_N = 0.3 + 0.1 * beats(T_S)


def ahead(predictor: Ensemble, samples: int, horizon_ms: int, first: int = 0) -> float:
    """Return the prediction `horizon_ms` after the last of some samples."""
    return predictor.predict(T0_NS + (first + samples - 1 + horizon_ms) * MS)


@pytest.mark.parametrize("name", LEARNT)
def test_a_predictor_learns_a_pulse(name: PredictorName) -> None:
    predictor, errors_n = Ensemble(name), []
    for first in range(0, 13_000, 5):
        feed(predictor, FORCE_N[first : first + 5], first)
        if first >= 12_000:
            errors_n.append(ahead(predictor, 5, 100, first) - FORCE_N[first + 104])
    assert np.sqrt(np.mean(np.square(errors_n))) < 0.1 * FORCE_N.std()


def test_the_stack_is_nearly_as_good_as_its_best_expert_and_estimates_its_error() -> None:
    noisy_n = FORCE_N + 2e-3 * np.random.default_rng(1).standard_normal(len(FORCE_N))
    stack = Ensemble("stack")
    squares: dict[int, list[Floats]] = {20: [], 100: [], 200: []}
    for first in range(0, 15_500, 5):
        feed(stack, noisy_n[first : first + 5], first)
        for horizon_ms, found in squares.items() if first > 12_000 else ():
            at = first + 4 + horizon_ms
            found.append((np.array(stack.predict_each(T0_NS + at * MS)) - FORCE_N[at]) ** 2)
    for found in squares.values():
        *experts_n, stack_n = np.sqrt(np.mean(found, axis=0)).tolist()
        assert stack_n < 1.2 * min(experts_n) + 0.03 * FORCE_N.std()
    # A cell's noise is that of the mean of 5 samples.
    actual_n = math.sqrt(np.mean(squares[100], axis=0)[-1] + 2e-3**2 / 5)
    assert stack.error_n(100 * MS) == pytest.approx(actual_n, rel=0.5)
    assert (stack.error_n(240 * MS) or 0) > 0
    # Nothing is predicted beyond 250 ms.
    assert stack.error_n(260 * MS) is None


@pytest.mark.parametrize("name", LEARNT)
def test_later_samples_change_no_earlier_prediction(name: PredictorName) -> None:
    other_n = FORCE_N.copy()
    other_n[6_000:] += 1.0
    one, other = Ensemble(name), Ensemble(name)
    differ = False
    for first in range(0, 6_050, 5):
        feed(one, FORCE_N[first : first + 5], first)
        feed(other, other_n[first : first + 5], first)
        same = ahead(one, 5, 60, first) == ahead(other, 5, 60, first)
        assert same or first >= 6_000
        differ |= not same
    assert differ


@pytest.mark.parametrize("name", LEARNT)
def test_a_predictor_holds_until_it_has_learnt(name: PredictorName) -> None:
    predictor = Ensemble(name)
    assert predictor.predict(T0_NS) == 0.0
    for first in range(0, 900, 5):
        feed(predictor, FORCE_N[first : first + 5], first)
        assert ahead(predictor, 5, 50, first) == FORCE_N[first + 4]
    assert predictor.error_n(50 * MS) is None


def learning_errors(noise_n: float, from_s: float) -> tuple[Floats, Floats]:
    """Return the stack's errors 60 ms ahead, in phase, and their estimates, from a time on."""
    sensed_n = FORCE_N + noise_n * np.random.default_rng(4).standard_normal(len(FORCE_N))
    stack, errors_n, estimates_n = Ensemble("stack"), [], []
    for first in range(0, 15_000, 5):
        feed(stack, sensed_n[first : first + 5], first)
        if first >= 1_000 * from_s:
            errors_n.append(ahead(stack, 5, 60, first) - FORCE_N[first + 64])
            estimates_n.append(stack.error_n(60 * MS) or math.inf)
    return np.array(errors_n), np.array(estimates_n)


def test_the_stack_learns_a_regular_pulse_in_four_seconds() -> None:
    errors_n, estimates_n = learning_errors(5e-4, from_s=4.0)
    assert np.sqrt(np.mean(errors_n[:200] ** 2)) < 0.02 * np.ptp(FORCE_N)
    assert estimates_n[200] < 0.02 * np.ptp(FORCE_N)


@pytest.mark.parametrize("name", LEARNT)
def test_a_constant_stays_constant_and_predictions_recover_from_enormous_samples(
    name: PredictorName,
) -> None:
    predictor = Ensemble(name)
    feed(predictor, np.full(4_000, 0.3))
    assert ahead(predictor, 4_000, 100) == pytest.approx(0.3, abs=1e-6)
    predictor, force_n = Ensemble(name), FORCE_N.copy()
    force_n[3_000:3_050] = [1.7e308, -1.7e308] * 25
    feed(predictor, force_n[:9_000])
    assert ahead(predictor, 9_000, 50) == pytest.approx(FORCE_N[9_049], abs=FORCE_N.std())


@pytest.mark.parametrize("constant_n", [0.1, -3.2845198586359663])
def test_a_pulse_after_a_constant_is_learnt_as_one_from_the_start(constant_n: float) -> None:
    # Means of a constant over cells differ by their rounding, which is no size of a pulse.
    pulse_n, ensemble = constant_n + FORCE_N - FORCE_N[0], Ensemble("stack")
    for first in range(0, 1_500, 5):
        feed(ensemble, np.full(5, constant_n), first)
    assert ensemble.scale == 0
    for first in range(1_500, 14_500, 5):
        feed(ensemble, pulse_n[first - 1_500 : first - 1_495], first)
    assert 0.2 * FORCE_N.std() < ensemble.scale < 5 * FORCE_N.std()
    assert ahead(ensemble, 5, 50, 14_495) == pytest.approx(pulse_n[13_049], abs=0.005)


def test_late_samples_improve_a_prediction() -> None:
    """A peak of 60 ms never arrives, arrives late, or arrives on time."""
    gap = slice(5_700, 5_760)
    never, late, whole = (Ensemble("fir") for _ in range(3))
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
    without, corrected, best = (
        np.array([ahead(predictor, 10, ahead_ms, gap.stop) for ahead_ms in range(10, 200)])
        for predictor in (never, late, whole)
    )
    assert np.abs(corrected - best).max() < 0.5 * np.abs(without - best).max()


@pytest.mark.parametrize(("period_ns", "frame"), [(250_000, 20), (8_333_333, 1), (10 * MS, 2)])
def test_a_pulse_is_predicted_at_any_sampling_rate(period_ns: int, frame: int) -> None:
    predictor, t_s = Ensemble("stack"), np.arange(0, 10, period_ns * 1e-9)
    force_n = 0.3 + 0.1 * beats(t_s)
    feed(predictor, force_n, period_ns=period_ns, frame=frame)
    newest = len(force_n) // frame * frame - 1
    at_s = t_s[newest] + np.arange(0.02, 0.2, 0.01)
    found = [predictor.predict(T0_NS + round(instant_s * 1e9)) for instant_s in at_s]
    np.testing.assert_allclose(found, 0.3 + 0.1 * beats(at_s), atol=0.03)


@pytest.mark.parametrize("pulse", finger_pulses(30.0, 1), ids=str)
def test_at_low_rates_and_in_noise_the_stack_is_no_worse_than_its_members(pulse: Pulse) -> None:
    stack, linear = Ensemble("stack"), build_predictors("linear")[0]
    squares, period_ns = [], round(1e9 / pulse.rate_hz)
    for first in range(0, len(pulse.sensed) - pulse.frame, pulse.frame):
        for predictor in (stack, linear):
            frame = pulse.sensed[first : first + pulse.frame]
            feed(predictor, frame, first, period_ns, pulse.frame)
        newest = first + pulse.frame - 1
        ahead = newest + math.ceil(10 * MS / period_ns)
        if newest * period_ns > 12e9 and ahead < len(pulse.sensed):
            at_ns = T0_NS + ahead * period_ns
            found = np.array([linear.predict(at_ns), *stack.predict_each(at_ns)])
            squares.append((found - pulse.sensed[ahead]) ** 2)
    *members, stacked = np.sqrt(np.mean(squares, axis=0))
    assert stacked < 1.03 * min(members)


def test_predictions_recover_from_an_outage() -> None:
    predictor = Ensemble("stack")
    feed(predictor, FORCE_N[:5_000])
    feed(predictor, FORCE_N[6_000:9_000], 6_000)
    late = [ahead(predictor, 3_000, ms, 6_000) - FORCE_N[8_999 + ms] for ms in range(20, 200)]
    assert np.sqrt(np.mean(np.square(late))) < 0.3 * FORCE_N.std()


def test_a_path_is_smooth_and_a_new_cell_changes_it_at_the_first_tick() -> None:
    predictor, samples = Ensemble("stack"), 6_000
    feed(predictor, FORCE_N[:samples])
    path = [ahead(predictor, samples, ahead_ms) for ahead_ms in range(1, 250)]
    assert np.abs(np.diff(path, 2)).max() < 4 * np.abs(np.diff(FORCE_N, 2)).max()
    assert ahead(predictor, samples, 400) == ahead(predictor, samples, 10_000)
    times_ns = [T0_NS + (samples + number) * MS for number in range(5)]
    predictor.observe(times_ns, FORCE_N[samples : samples + 5].tolist())
    found = [ahead(predictor, samples, 50)]
    for _ in range(5):
        predictor.work()
        found.append(ahead(predictor, samples, 50))
    assert found[0] != found[1]
    assert found[1:] == found[1:2] * 5


def test_other_channels_are_predicted_by_the_first_ones_analogues() -> None:
    # The same beats 3 ms later, another size and an offset; and another shape.
    forces_n = np.stack([FORCE_N, 1.0 + 0.05 * beats(T_S - 0.003), 0.2 + 0.1 * beats(T_S) ** 2])
    joint = Ensemble("stack", channels=3)
    paths = [joint, *joint.others]
    for first in range(0, 12_000, 5):
        times_ns = [T0_NS + (first + number) * MS for number in range(5)]
        for path, force_n in zip(paths, forces_n, strict=True):
            path.observe(times_ns, force_n[first : first + 5].tolist())
        for _ in range(5):
            joint.work()
    for path, force_n in zip(paths, forces_n, strict=True):
        errors_n = [ahead(path, 12_000, ms) - force_n[11_999 + ms] for ms in range(10, 200)]
        assert np.sqrt(np.mean(np.square(errors_n))) < 0.1 * force_n.std()
        expected_n = path.error_n(100 * MS)
        assert expected_n is not None
        assert expected_n < 0.1 * force_n.std()


@pytest.mark.parametrize("dead_n", [0.0, 1e9])
def test_a_dead_channel_beside_it_leaves_the_first_ones_prediction_unchanged(dead_n: float) -> None:
    alone, joint = Ensemble("stack"), Ensemble("stack", channels=2)
    found = []
    for predictor in (alone, joint):
        for first in range(0, 6_000, 5):
            times_ns = [T0_NS + (first + number) * MS for number in range(5)]
            for other in predictor.others:
                other.observe(times_ns, [dead_n] * 5)
            predictor.observe(times_ns, FORCE_N[first : first + 5].tolist())
            for _ in range(5):
                predictor.work()
        found.append([ahead(predictor, 6_000, ms) for ms in range(10, 240, 10)])
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert ahead(joint.others[0], 6_000, 100) == pytest.approx(dead_n)
