"""The study of a recording: errors ahead of a regular pulse and of noise, and its advice."""

import numpy as np
import pytest

from telepulse.simulation.record_study import (
    AHEAD_MS,
    errors_ahead,
)
from tests.support.drawn_beats import BATCH, PERIOD_NS, RATE_HZ, draw, noisy

AT_100_MS = AHEAD_MS.index(100)


def test_a_regular_pulse_is_predicted_better_than_held_and_noise_is_not_predicted() -> None:
    regular = noisy(draw().force_n)[: 20 * RATE_HZ]
    for error in errors_ahead(regular, PERIOD_NS, BATCH):
        assert error.predicted_n < 0.2 * error.held_n
    noise = np.random.default_rng(1).standard_normal(20 * RATE_HZ)
    for error in errors_ahead(noise, PERIOD_NS, BATCH):
        # No prediction of noise is better than its mean, whose error is 1 in the long run.
        assert error.predicted_n > 0.95
        assert error.held_n == pytest.approx(np.sqrt(2), rel=0.05)


def test_a_held_sine_has_the_error_of_theory_at_any_rate_and_frame() -> None:
    for rate_hz, batch in ((100, 1), (250, 3)):
        sine = np.sqrt(2) * np.sin(2 * np.pi * np.arange(20 * rate_hz) / rate_hz)
        for error in errors_ahead(sine, 1_000_000_000 // rate_hz, batch):
            expected = 2 * np.sin(np.pi * error.ahead_ms * 1e-3)
            assert error.held_n == pytest.approx(expected, rel=0.02)
            assert error.predicted_n < 0.1 * error.held_n
