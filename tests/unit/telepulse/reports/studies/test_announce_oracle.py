"""The oracle's errors are those of what no R wave announces."""

import pytest

from telepulse.reports.studies.announce_oracle import HORIZONS_MS, score_oracle

SECONDS = 26.0


def test_errors_grow_with_the_horizon_and_with_the_jitter() -> None:
    usual, less = (score_oracle(("fibrillation", SECONDS, 1, each)) for each in (0.005, 0.001))
    assert usual.name == "fibrillation"
    assert len(usual.errors) == len(HORIZONS_MS)
    assert list(usual.errors) == sorted(usual.errors)
    assert less.errors[-1] < 0.5 * usual.errors[-1]


@pytest.mark.parametrize("name", ["variability", "ectopic"])
def test_an_onset_that_varies_by_5_ms_is_all_that_a_regular_pulse_hides(name: str) -> None:
    assert 0.01 < score_oracle((name, SECONDS, 1, 0.005)).errors[-1] < 0.07


def test_a_shape_that_follows_the_next_interval_adds_most_of_the_error() -> None:
    cued, without = (
        score_oracle((name, SECONDS, 1, 0.005))
        for name in ("fibrillation, shape cue", "fibrillation")
    )
    assert cued.errors[-1] > 1.5 * without.errors[-1]
