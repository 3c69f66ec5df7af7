"""The study of a recording: errors ahead of a regular pulse and of noise, and its advice."""

import numpy as np
import pytest

from telepulse.simulation.record_study import (
    AHEAD_MS,
    PLAYOUTS,
    Playout,
    RecordStudy,
    errors_ahead,
)
from tests.support.announced_pulses import announced_pulses
from tests.support.drawn_beats import BATCH, PERIOD_NS, RATE_HZ, SECONDS, draw, noisy

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


def test_an_ecg_in_the_file_lowers_the_error() -> None:
    announced = announced_pulses(SECONDS, 1, 0.005)[0]
    force_n = announced.pulse.sensed
    without, with_ecg = (
        errors_ahead(force_n, PERIOD_NS, BATCH, ecg)[AT_100_MS] for ecg in (None, announced.ecg_mv)
    )
    assert with_ecg.predicted_n < 0.7 * without.predicted_n
    assert with_ecg.held_n == without.held_n


def study(auto_n: float | None, at_once_n: float | None) -> RecordStudy:
    """Return a study of a pulse of 0.3 N, of which 0.03 N are noticed, with these errors now."""
    errors_n, delays_ms = (0.08, auto_n, at_once_n), (73.0, 20.0, 0.0)
    playouts = tuple(
        Playout(name, None if now_n is None else delay_ms, now_n, now_n and 0.003, 0.0, 0.0)
        for (name, *_), delay_ms, now_n in zip(PLAYOUTS, delays_ms, errors_n, strict=True)
    )
    return RecordStudy(30.0, 0.3, (), playouts)


@pytest.mark.parametrize(
    ("auto_n", "at_once_n", "begin", "stated"),
    [
        (0.03, 0.02, 'Leave compensation = "auto": the pulse', ("20 ms late", "10.0 %", "73 ms")),
        (0.031, 0.03, 'With compensation = "auto" the', ("10.3 %", '"0 s" the error is 10.0 %')),
        (0.045, 0.06, 'Leave compensation = "auto": this pulse is not', ("15.0 %", "1.0 %")),
        (None, None, "Nothing would be felt", ()),
    ],
)
def test_the_advice_follows_from_what_a_finger_notices(
    auto_n: float | None, at_once_n: float | None, begin: str, stated: tuple[str, ...]
) -> None:
    advice = study(auto_n, at_once_n).advice
    assert advice.startswith(begin)
    for figure in stated:
        assert figure in advice
