import numpy as np
import pytest

from display_node.prediction.expert import AHEAD, FURTHEST
from display_node.prediction.stack import Stack

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


def test_an_expert_that_was_silent_for_long_does_not_upset_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # 8000 steps of so short a memory are as a day of the usual one.
    monkeypatch.setattr("display_node.prediction.stack.FORGET", 0.9)
    stack, rng = Stack(np.array([1.0, 0.0])), np.random.default_rng(3)
    for step in range(8_000):
        coming = rng.standard_normal(len(AHEAD))
        stack.predict(0.0, np.vstack([coming, np.zeros(len(AHEAD))]))
        stack.learn(float(np.sin(step)))
    for _ in range(2 * FURTHEST):
        woken = stack.predict(0.0, np.ones((2, len(AHEAD))))
        stack.learn(0.5)
    assert np.abs(woken - 0.5).max() < 0.1
