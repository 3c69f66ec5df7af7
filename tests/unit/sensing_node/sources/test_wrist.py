from typing import Any

import numpy as np
import pytest

from protocol.config.scene import validate
from protocol.errors import SceneError
from sensing_node.sources.wrist import Wrist, WristScene
from telepulse import find_beats


def wrist(**keys: Any) -> Wrist:
    return Wrist(validate({"kind": "wrist"} | keys, WristScene, "[sensing]"))


def pulse_at(source: Wrist, force_n: float, seconds: float = 2.4) -> np.ndarray[Any, Any]:
    """Return the film's pulse at a hold-down force, after half a second."""
    blocks = []
    for number in range(round((0.5 + seconds) / 0.02)):
        blocks.append(pressed(source, force_n)[:, 0])
        assert number < 25 or source.force_n == pytest.approx(force_n, rel=0.03, abs=0.01)
    return np.concatenate(blocks[25:])


def pressed(source: Wrist, force_n: float) -> np.ndarray[Any, Any]:
    """Return the next 20 ms of all channels at a set-point."""
    source.press(force_n)
    return source.take(20)


def test_the_pulse_is_highest_at_the_mean_arterial_pressure_and_has_the_scenes_height() -> None:
    source = wrist(peak_to_peak="0.2 N")
    best_n = source.artery.best_n
    heights = {share: float(np.ptp(pulse_at(source, share * best_n))) for share in (0.85, 1, 1.15)}
    assert heights[1] == pytest.approx(0.2, rel=0.03)
    assert heights[0.85] < heights[1] > heights[1.15]


def test_the_load_cell_measures_the_static_force_and_the_pulse() -> None:
    source = wrist(cell_noise="0 N")
    pulse_at(source, 1.2)
    blocks = []
    for _ in range(8):
        source.press(1.2)
        blocks.append(source.take(100))
    pulse, cell = np.concatenate(blocks).T
    assert (cell - pulse).mean() == pytest.approx(source.force_n, rel=0.02)
    assert float(np.ptp(cell)) > 0.8 * float(np.ptp(pulse))


def test_an_ecg_announces_each_beat_and_leaves_the_pulse_as_it_is() -> None:
    pulse = {"kind": "synthetic", "announce": {"transit": "180 ms", "noise": "0 V"}}
    plain, announced = wrist(), wrist(pulse=pulse)
    assert [channel.name for channel in announced.channels] == ["pulse", "hold-down", "announce"]
    alone, values = (
        np.concatenate([pressed(source, 1.0) for _ in range(500)]) for source in (plain, announced)
    )
    np.testing.assert_array_equal(values[:, :2], alone)
    film, _, ecg_mv = values[2000:].T
    onsets = [beat.onset_ns * 1e-6 for beat in find_beats(film, 1000)]
    peaks = [t for t in range(1, len(film) - 1) if ecg_mv[t - 1] < ecg_mv[t] >= ecg_mv[t + 1]]
    r_waves = [t for t in peaks if ecg_mv[t] > 0.7 * ecg_mv.max()]
    assert len(onsets) > 5
    # An onset is found a little after the transit time, where the pulse has begun to rise.
    transits = [onset - max(t for t in r_waves if t < onset - 100) for onset in onsets]
    assert min(transits) > 180
    assert max(transits) < min(transits) + 5 < 230


def test_off_the_wrist_nothing_is_measured() -> None:
    values = wrist(cell_noise="0 N").take(1000)
    assert not values.any()


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ({"systolic": "10 kPa", "diastolic": "12 kPa"}, "systolic must be above diastolic"),
        (
            {"pulse": {"kind": "synthetic", "position": [{"name": "cun"}]}},
            "a wrist is pressed at one position",
        ),
    ],
)
def test_an_impossible_wrist_is_refused(keys: dict[str, Any], reason: str) -> None:
    with pytest.raises(SceneError, match=reason):
        wrist(**keys)
