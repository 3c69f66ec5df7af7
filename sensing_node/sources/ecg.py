"""A synthetic electrocardiogram (ECG), whose R waves announce the beats of a synthetic pulse.

References
----------
McSharry, Clifford, Tarassenko and Smith (2003), A dynamical model for generating synthetic
electrocardiogram signals, IEEE Transactions on Biomedical Engineering 50(3): the angles θ, widths b
and strengths a of five events. An event's amplitude is a b² over that of the R wave; at 60 beats a
minute its time is θ / 2π s from the R wave.
"""

from collections import deque
from collections.abc import Iterable
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from protocol.config.quantities import Nanoseconds, Volts
from protocol.config.scene import Section
from protocol.wire.stream import ANNOUNCE, Channel
from sensing_node.sources.heart import Heartbeat

MILLIVOLTS = 1e3
R_WAVE_MV = 1.0


class EcgWave(NamedTuple):
    """One Gaussian of an ECG: amplitude over the R wave's, time from it and width in s.

    stretches: whether the times follow the beat's length, as those of P and T waves do.
    """

    amplitude: float
    after_s: float
    width_s: float
    stretches: bool


WAVES = (
    EcgWave(0.25, -1 / 6, 0.0398, True),
    EcgWave(-0.17, -1 / 24, 0.0159, False),
    EcgWave(1.0, 0.0, 0.0159, False),
    EcgWave(-0.25, 1 / 24, 0.0159, False),
    EcgWave(0.4, 1 / 4, 0.0637, True),
)
# Times before and after an R wave at which its beat is drawn; the rest is below 1e-4 of it.
BEFORE_S, AFTER_S = 0.35, 0.55
# Greatest jitter over its standard deviation.
MOST = 4.0


class AnnounceScene(Section):
    """The `announce` table of a synthetic source: an ECG in the channel "announce".

    transit: from the R wave to the pulse's onset at distance 0. transit_jitter: its standard
    deviation. noise: RMS.
    """

    transit_ns: Annotated[Nanoseconds, Field(ge=0, le=500_000_000)] = 180_000_000
    transit_jitter_ns: Annotated[Nanoseconds, Field(ge=0, le=50_000_000)] = 0
    noise_v: Annotated[Volts, Field(ge=0, le=0.01)] = 10e-6


def draw_ecg(
    t_s: NDArray[np.floating[Any]], beats: Iterable[tuple[float, float]]
) -> NDArray[np.float64]:
    """Return the ECG in mV at ascending times, from each beat's R wave and stretch."""
    ecg_mv = np.zeros(len(t_s))
    for at_s, stretch in beats:
        first, last = np.searchsorted(t_s, (at_s - BEFORE_S, at_s + AFTER_S))
        since_s = t_s[first:last] - at_s
        for wave in WAVES:
            scale = stretch if wave.stretches else 1.0
            z = (since_s - scale * wave.after_s) / (scale * wave.width_s)
            ecg_mv[first:last] += R_WAVE_MV * wave.amplitude * np.exp(-0.5 * z * z)
    return ecg_mv


class EcgColumn:
    """The channel "announce": an ECG whose R waves precede the beats' onsets by the transit time.

    r_waves_s: times of the last R waves.
    """

    def __init__(self, scene: AnnounceScene, period_s: float, rng: np.random.Generator) -> None:
        self.channel = Channel(ANNOUNCE, "mV")
        self._scene, self._period_s, self._rng = scene, period_s, rng
        self._beats: deque[tuple[float, float]] = deque(maxlen=16)
        self._drawn = 0

    @property
    def r_waves_s(self) -> list[float]:
        """Times of the last R waves in s."""
        return [at_s for at_s, _ in self._beats]

    def draw(self, beat: Heartbeat) -> NDArray[np.float64]:
        """Draw one beat, and return the samples in mV that no later beat can change."""
        scene = self._scene
        transit_s, deviation_s = scene.transit_ns * 1e-9, scene.transit_jitter_ns * 1e-9
        jitter = max(-MOST, min(MOST, float(self._rng.standard_normal())))
        self._beats.append((beat.onset_s - transit_s - deviation_s * jitter, beat.stretch))
        end_s = beat.next_onset_s - transit_s - MOST * deviation_s - BEFORE_S
        first = self._drawn
        self._drawn = max(first, int(end_s / self._period_s))
        t_s = np.arange(first, self._drawn) * self._period_s
        noise_mv = MILLIVOLTS * scene.noise_v * self._rng.standard_normal(len(t_s))
        return draw_ecg(t_s, self._beats) + noise_mv
