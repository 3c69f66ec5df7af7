"""Pulses as sensors at a finger give them: low rate, coarse steps, noise, wandering height.

Their noise is a tremor between 5 and 15 Hz, within the band of the pulse: no filter removes it, and
what was sensed is what is to be predicted.
"""

from typing import Final, NamedTuple

import numpy as np

from sensing_node.sources.heart import NOMINAL_BEAT_S
from tests.support.drawn_pulses import (
    FRAME,
    RATE_HZ,
    SCORED_FROM_S,
    Floats,
    Pulse,
    drawn,
    make_rhythm,
)

TREMOR_HZ: Final = (5.0, 8.0)
TREMOR_FALLS_FROM_HZ: Final = 15.0
# Of the baseline, in deviations of the pulse, and of the height of beats.
WANDER: Final = 0.25
WANDER_HZ: Final = (0.05, 0.4)
HEIGHT_HZ: Final = (0.02, 0.3)
# Natural logarithm of the height of the tremor's bursts.
BURSTS_HZ: Final = (0.03, 0.3)


class FingerSensor(NamedTuple):
    """A sensor and its finger.

    rate_hz: of its samples, one in a frame, or interpolated to 1 kHz. steps: of its converter, in a
    deviation of the pulse. tremor, height: deviations, over that of the pulse, and over the mean
    height. bursts: deviation of the logarithm of the tremor's amplitude.
    """

    rate_hz: float
    interpolated: bool
    steps: float
    tremor: float
    height: float
    bursts: float = 0.0


SENSORS: Final = {
    "finger, 100 Hz": FingerSensor(100.0, False, 40.0, 0.2, 0.3),
    "finger, 100 Hz to 1 kHz": FingerSensor(100.0, True, 40.0, 0.7, 0.4),
    "finger, 117 Hz": FingerSensor(117.0, False, 15.0, 0.35, 0.2),
    "finger, 130 Hz, bursts": FingerSensor(130.0, False, 25.0, 0.3, 0.3, 0.8),
}


def finger_pulses(seconds: float, seed: int) -> list[Pulse]:
    """Return a pulse of each sensor."""
    return [
        _sensed(name, sensor, seconds, np.random.default_rng((seed, 200 + number)))
        for number, (name, sensor) in enumerate(SENSORS.items())
    ]


def _sensed(name: str, sensor: FingerSensor, seconds: float, rng: np.random.Generator) -> Pulse:
    beats = make_rhythm(rng, seconds, 0.05, lambda _: 66.0)
    pulse = drawn(beats, "wide", seconds, NOMINAL_BEAT_S)
    pulse = (pulse - pulse.mean()) / pulse.std()
    pulse *= 1 + sensor.height * _within(rng, len(pulse), HEIGHT_HZ)
    pulse += WANDER * _within(rng, len(pulse), WANDER_HZ)
    pulse += sensor.tremor * _tremor(rng, len(pulse), sensor.bursts)
    t_s = np.arange(len(pulse)) / RATE_HZ
    taken_s = np.arange(0, t_s[-1], 1 / sensor.rate_hz)
    sensed = np.round(np.interp(taken_s, t_s, pulse) * sensor.steps) / sensor.steps
    sensed /= sensed[taken_s >= SCORED_FROM_S].std()
    if not sensor.interpolated:
        return Pulse(name, sensed, sensed, sensor.rate_hz, 1)
    sensed = np.interp(t_s[t_s <= taken_s[-1]], taken_s, sensed)
    return Pulse(name, sensed, sensed, RATE_HZ, FRAME)


def _within(rng: np.random.Generator, count: int, band_hz: tuple[float, float]) -> Floats:
    """Return noise of a band with a deviation of 1."""
    from scipy.signal import butter, sosfilt

    band = butter(2, band_hz, "bandpass", fs=RATE_HZ, output="sos")
    noise = sosfilt(band, rng.standard_normal(count))
    return np.asarray(noise / noise.std())


def _tremor(rng: np.random.Generator, count: int, bursts: float) -> Floats:
    """Return a tremor of a deviation of 1."""
    from scipy.signal import butter, sosfilt

    band = butter(1, TREMOR_HZ, "bandpass", fs=RATE_HZ, output="sos")
    falls = butter(1, TREMOR_FALLS_FROM_HZ, fs=RATE_HZ, output="sos")
    tremor = sosfilt(np.concatenate([band, falls]), rng.standard_normal(count))
    tremor *= np.exp(bursts * _within(rng, count, BURSTS_HZ))
    return np.asarray(tremor / tremor[round(SCORED_FROM_S * RATE_HZ) :].std())
