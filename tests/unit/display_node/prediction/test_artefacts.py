"""Artefacts are found at once, end, and are not found in a pulse that changes."""

from unittest.mock import patch

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.prediction.artefacts import FEWEST, HELD, LONGEST, ArtefactDetector
from display_node.prediction.ensemble import Ensemble
from display_node.prediction.history import History
from tests.support.drawn_beats import BATCH, RATE_HZ, draw, moved, noisy, prediction_errors_n

Floats = NDArray[np.float64]
STEPS_A_BEAT = 160


def pulse(steps: int, height: float = 1.0) -> Floats:
    return height * np.abs(np.sin(np.pi * np.arange(steps) / STEPS_A_BEAT)) ** 3


def present(values: Floats) -> list[int]:
    """Return the steps at which an artefact is present."""
    history, detector = History(8_192), ArtefactDetector()
    found = []
    for step, value in enumerate(values.tolist()):
        history.push(value)
        detector.observe(history)
        if detector.present:
            found.append(step)
    return found


@pytest.mark.parametrize("size", [-0.5, 2.0, 1e9])
def test_an_artefact_is_found_at_once_and_ends_when_no_filter_has_it(size: float) -> None:
    values = pulse(4_000)
    values[2_000:2_100] = size
    assert present(values) == list(range(2_000, 2_099 + HELD))


def test_a_value_that_is_no_number_is_an_artefact() -> None:
    values = pulse(3_000)
    values[2_000] = np.nan
    assert present(values)[0] == 2_000


def test_a_pulse_that_varies_drifts_or_pauses_has_none() -> None:
    rng, steps = np.random.default_rng(1), np.arange(6_000)
    varying = pulse(6_000) * (1 + 0.1 * np.sin(steps / 700)) + 0.01 * rng.standard_normal(6_000)
    assert present(varying) == []
    assert present(varying + steps / 2_000) == []
    pause = varying.copy()
    pause[3_000:4_500] = 0.0
    assert present(pause) == []


def test_a_pulse_that_stays_larger_has_changed() -> None:
    values = np.concatenate([pulse(3_200), pulse(6_000, height=3.0)])
    found = present(values)
    assert 3_200 < found[0] < 3_200 + STEPS_A_BEAT
    assert found[-1] <= found[0] + LONGEST
    # A later artefact of that pulse is found again.
    values[8_000:8_050] = 6.0
    assert present(values)[-1] == 8_049 + HELD - 1


def test_nothing_is_found_before_a_beat_was_seen() -> None:
    values = pulse(FEWEST)
    values[FEWEST - 50 :] = 5.0
    assert present(values) == []


@pytest.mark.system
def test_predictions_are_soon_as_good_as_without_the_artefact() -> None:
    pulse = draw().force_n[: 30 * RATE_HZ]
    disturbed = moved(noisy(pulse))

    def rmse_n(force_n: Floats) -> float:
        """Return the error from 2 s after the artefact on, 100 ms ahead."""
        errors_n = prediction_errors_n(Ensemble("stack"), force_n, pulse, 100)
        return float(np.sqrt(np.mean(errors_n[21 * RATE_HZ // BATCH :] ** 2)))

    undisturbed_n, found_n = rmse_n(noisy(pulse)), rmse_n(disturbed)
    with patch.object(ArtefactDetector, "observe"):
        learnt_n = rmse_n(disturbed)
    assert found_n < 1.3 * undisturbed_n
    assert learnt_n > 1.1 * found_n
