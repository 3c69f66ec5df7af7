"""A synthetic ECG has its R waves where the pulse's onsets are, less the transit time."""

import numpy as np
import pytest

from display_node.prediction.r_waves import RWaveDetector
from protocol.wire.stream import Channel
from sensing_node.sources.heart import AnnounceScene, draw_ecg
from sensing_node.sources.synthetic import PositionScene, SyntheticScene, SyntheticSource

ECG = AnnounceScene(transit="170 ms", transit_jitter="8 ms", noise="0 V")


def source(announce: AnnounceScene | None, **options: object) -> SyntheticSource:
    scene = SyntheticScene(
        kind="synthetic", heart_rate_variability=0.1, announce=announce, **options
    )
    return SyntheticSource(scene)


def test_an_ecg_is_one_more_channel_and_leaves_the_others_as_they_are() -> None:
    places = (PositionScene(name="cun"), PositionScene(name="chi", distance="5 cm"))
    with_ecg, without = source(ECG, position=places), source(None, position=places)
    assert with_ecg.channels == (*without.channels, Channel("announce", "mV"))
    np.testing.assert_array_equal(with_ecg.take(20_000)[:, :2], without.take(20_000))


def test_blocks_of_any_size_have_the_same_samples() -> None:
    blocks = source(ECG)
    whole = source(ECG).take(5_000)
    parts = [blocks.take(count) for count in (1, 7, 992, 3_000, 1_000)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


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


def test_the_waves_have_the_heights_and_places_of_the_model() -> None:
    t_s = np.arange(-0.4, 0.6, 1e-3)
    ecg_mv = draw_ecg(t_s, [(0.0, 1.0)])
    assert ecg_mv.max() == pytest.approx(1.0, abs=0.05)
    assert t_s[ecg_mv.argmax()] == pytest.approx(0, abs=2e-3)
    after, before = t_s > 0.1, t_s < -0.1
    assert t_s[after][ecg_mv[after].argmax()] == pytest.approx(0.25, abs=2e-3)
    assert t_s[before][ecg_mv[before].argmax()] == pytest.approx(-1 / 6, abs=2e-3)
