"""The pulse of this report: 75 beats/min, of 1 N from peak to peak unless it is scaled.

Where errors are compared it has no mean: a PVDF film passes none, and a preload of unknown
size would only add to them.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sensing_node.sources.synthetic import NOMINAL_BEAT_S, SyntheticScene, SyntheticSource
from telepulse.reports.paper.numbers import PULSE_PER_MIN

Preset = Literal["paper", "wide"]
# Slow parts of the spectrum's pulse, over the standard deviation of its beats; fitted, as the
# waves' widths and heights are, to the energy shares that the paper prints.
SLOW_DC = 0.034
SLOW_RESPIRATION = 0.256
SLOW_RESPIRATION_HZ = 0.25


def beats(preset: Preset, rate_hz: float, seconds: float) -> NDArray[np.float64]:
    """Mean-free pulse of 1 N from peak to peak, from 0 to `seconds` with both ends, in N."""
    return _pulse(preset, rate_hz, seconds, preload_n=0.0, respiration=0.0)


def beats_with_slow_parts(preset: Preset, rate_hz: float, seconds: float) -> NDArray[np.float64]:
    """`beats` with the constant and the respiration that the paper's spectrum has, in N."""
    return _pulse(preset, rate_hz, seconds, SLOW_DC * deviation_n(preset), SLOW_RESPIRATION)


def deviation_n(preset: Preset) -> float:
    """Standard deviation of `beats` over one whole beat: the RMSE of doing nothing, in N."""
    return float(beats(preset, 1e4, NOMINAL_BEAT_S)[:-1].std())


def raw_mean_n(preset: Preset) -> float:
    """Mean over a beat of the bare waves, before it is taken out, in N."""
    # Between two beats the bare waves are all but 0, so the mean is what lifts that floor.
    return -float(beats(preset, 1e4, NOMINAL_BEAT_S).min())


def _pulse(
    preset: Preset, rate_hz: float, seconds: float, preload_n: float, respiration: float
) -> NDArray[np.float64]:
    scene = SyntheticScene.model_validate(
        {
            "kind": "synthetic",
            "preset": preset,
            "rate": f"{rate_hz} Hz",
            "heart_rate": f"{PULSE_PER_MIN} /min",
            "peak_to_peak": "1 N",
            "preload": f"{preload_n} N",
            "respiration": respiration,
            "respiration_rate": f"{SLOW_RESPIRATION_HZ} Hz",
        }
    )
    return SyntheticSource(scene).take(round(seconds * rate_hz) + 1)[:, 0]
