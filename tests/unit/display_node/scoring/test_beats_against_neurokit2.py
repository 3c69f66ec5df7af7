"""Rate and quality of beats against neurokit2, which is no dependency.

The tests are skipped where it is not installed.
"""

import numpy as np
import pytest

from tests.support.drawn_beats import RATE_HZ, analysed, draw, frames, moved, noisy, seconds
from tests.support.drawn_pulses import recorded_pulses

neurokit2 = pytest.importorskip("neurokit2", reason="neurokit2 is not installed")
# Its use of pandas is not ours to mend.
pytestmark = pytest.mark.filterwarnings("default")
PULSES = {"drawn": noisy(draw().force_n), **recorded_pulses(60.0)}


def peaks_s(force_n: np.ndarray) -> np.ndarray:
    """Return the systolic peaks that neurokit2 finds (Elgendi's method)."""
    cleaned = neurokit2.ppg_clean(force_n, sampling_rate=RATE_HZ)
    return np.asarray(neurokit2.ppg_findpeaks(cleaned, RATE_HZ)["PPG_Peaks"]) / RATE_HZ


@pytest.mark.parametrize("name", PULSES)
def test_the_rate_is_about_that_of_neurokit2(name: str) -> None:
    beats = [beat for beat in analysed(frames(PULSES[name])) if beat.good]
    found_s = peaks_s(PULSES[name])
    first_s, last_s = seconds(beats[0].onset_ns), seconds(beats[-1].onset_ns)
    within_s = found_s[(found_s > first_s) & (found_s < last_s)]
    interval_s = float(np.median([beat.interval_s for beat in beats]))
    assert interval_s == pytest.approx(np.median(np.diff(within_s)), rel=0.05)


def test_the_quality_falls_where_that_of_neurokit2_does() -> None:
    """A hand moves from 15 to 19 s; both qualities compare a beat with the usual one."""
    disturbed = moved(noisy(draw().force_n))
    cleaned = neurokit2.ppg_clean(disturbed, sampling_rate=RATE_HZ)
    theirs = np.asarray(
        neurokit2.ppg_quality(cleaned, sampling_rate=RATE_HZ, method="templatematch")
    )
    beats = [beat for beat in analysed(frames(disturbed)) if beat.quality is not None]
    onsets_s = np.array([seconds(beat.onset_ns) for beat in beats])
    ours = np.array([beat.quality for beat in beats])
    moving = (onsets_s > 15.0) & (onsets_s < 19.0)
    still = (onsets_s < 14.0) | (onsets_s > 22.0)
    at = np.clip(np.round((onsets_s + 0.2) * RATE_HZ).astype(int), 0, len(theirs) - 1)
    assert ours[moving].mean() < ours[still].mean() - 0.3
    assert np.nanmean(theirs[at[moving]]) < np.nanmean(theirs[at[still]])
