"""A synthetic ECG has its R waves where the pulse's onsets are, less the transit time."""

import numpy as np
import pytest

from display_node.prediction.r_waves import RWaveDetector
from sensing_node.sources.heart import AnnounceScene
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource

ECG = AnnounceScene(transit="170 ms", transit_jitter="8 ms", noise="0 V")


def source(announce: AnnounceScene | None, **options: object) -> SyntheticSource:
    scene = SyntheticScene(
        kind="synthetic", heart_rate_variability=0.1, announce=announce, **options
    )
    return SyntheticSource(scene)


def test_r_waves_precede_the_onsets_by_the_transit_time() -> None:
    made = source(ECG)
    ecg_mv = made.take(60_000)[:, 1]
    times_ns = list(range(0, 60_000_000_000, 1_000_000))
    found_s = [wave.at_ns * 1e-9 for wave in RWaveDetector().observe(times_ns, ecg_mv.tolist())]
    onsets_s = np.array([beat.onset_s for beat in made.beats])
    transits_s = np.array([onsets_s[onsets_s > at_s][0] - at_s for at_s in found_s[2:-2]])
    assert len(transits_s) > 65
    assert transits_s.mean() == pytest.approx(0.17, abs=0.003)
    assert transits_s.std() == pytest.approx(0.008, abs=0.003)
