"""A synthetic wrist that can be pressed: an artery in soft tissue, under a probe with a drive.

The arterial pressure has the synthetic pulse's waveform. The artery follows a tube law, so that
the pulse at the film rises with the hold-down force until the outside pressure is the mean arterial
one, then falls; beyond, the artery is closed in diastole and the pulse is flat there.
"""

import math
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.config.quantities import Metres, Newtons, Pascals
from protocol.tissue import StiffeningLaw, TubeLaw
from protocol.wire.description import HOLD_DOWN, PULSE, Channel
from sensing_node.press.probe import CLEARANCE_M, Probe, ProbeLimits
from sensing_node.press.set_points import PressedProbe
from sensing_node.sources.source import SampleSource, SourceContext, SourceScene
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource

# First-order lag of the modelled drive, and of film and load cell. Both sensors have the same, so
# that each of their samples belongs to one hold-down.
DRIVE_LAG_S, SENSOR_LAG_S = 5e-3, 2e-3
# A time that contains a whole beat of the slowest heart.
BEATS_S = 7.0


class WristScene(SourceScene):
    """The `source` table of kind "wrist".

    pulse: the waveform of the arterial pressure, a synthetic pulse; its height is that from
    diastolic to systolic. With `announce` the stream has an ECG besides. peak_to_peak: height of
    the pulse at the film at the best hold-down. probe_radius: its area turns force into pressure at
    the artery. knee and length: law of the tissue under the probe, F = knee · (exp(depth / length)
    − 1). noise and cell_noise: of the film and of the load cell.
    """

    pressable: ClassVar[bool] = True
    kind: Literal["wrist"]
    pulse: SyntheticScene = SyntheticScene(kind="synthetic")
    systolic_pa: Annotated[Pascals, Field(ge=5e3, le=4e4)] = 16e3
    diastolic_pa: Annotated[Pascals, Field(ge=2e3, le=3e4)] = 10.7e3
    peak_to_peak_n: Annotated[Newtons, Field(gt=0, le=10)] = 0.3
    probe_radius_m: Annotated[Metres, Field(ge=1e-3, le=2e-2)] = 5.6e-3
    knee_n: Annotated[Newtons, Field(ge=0.01, le=10)] = 0.3
    length_m: Annotated[Metres, Field(ge=1e-4, le=1e-2)] = 1.2e-3
    noise_n: Annotated[Newtons, Field(ge=0, le=1)] = 0.0
    cell_noise_n: Annotated[Newtons, Field(ge=0, le=1)] = 0.3e-3

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return self.pulse.rate_hz

    def build(self, context: SourceContext) -> "Wrist":
        """See `SourceScene.build`."""
        return Wrist(self, context.press)

    @model_validator(mode="after")
    def _has_a_pulse(self) -> "WristScene":
        if self.systolic_pa <= self.diastolic_pa:
            raise ValueError("systolic must be above diastolic")
        if self.pulse.position:
            raise ValueError("pulse: a wrist is pressed at one position; leave position out")
        return self


class Artery:
    """The pulse at the film for a pressure in the artery and a hold-down force.

    diastolic_pa, mean_pa: arterial pressures. best_n: hold-down with the highest pulse.
    """

    def __init__(self, scene: WristScene, mean_share: float) -> None:
        self._area_m2 = math.pi * scene.probe_radius_m**2
        self.diastolic_pa, self._systolic_pa = scene.diastolic_pa, scene.systolic_pa
        self.mean_pa = scene.diastolic_pa + mean_share * (scene.systolic_pa - scene.diastolic_pa)
        self.best_n = self.mean_pa * self._area_m2
        self._tube = TubeLaw.highest_at_mean(mean_share)
        self._n_per_pa = scene.peak_to_peak_n / self._height(self.mean_pa)

    def pulse_n(self, pressure_pa: float, hold_down_n: float) -> float:
        """Return the pulse at the film, which is blind to the static force: above diastole."""
        outside_pa = max(hold_down_n, 0.0) / self._area_m2
        return self._n_per_pa * self._tube.height(outside_pa, self.diastolic_pa, pressure_pa)

    def height_n(self, hold_down_n: float) -> float:
        """Return the pulse's peak to peak at a hold-down force."""
        return self._n_per_pa * self._height(max(hold_down_n, 0.0) / self._area_m2)

    def _height(self, outside_pa: float) -> float:
        return self._tube.height(outside_pa, self.diastolic_pa, self._systolic_pa)


class WristSensors:
    """The arterial pressure under a probe, film and load cell that sense it, and an ECG.

    artery: the artery under the probe. period_ns: time between samples.
    """

    channels: tuple[Channel, ...] = (Channel(PULSE), Channel(HOLD_DOWN))

    def __init__(self, scene: WristScene) -> None:
        clean = {"peak_to_peak_n": 1.0, "preload_n": 0.0, "noise_n": 0.0, "hum_n": 0.0}
        waveform = scene.pulse.model_copy(update=clean)
        regular = {
            **{"heart_rate_variability": 0.0, "respiration": 0.0, "ectopic": 0.0},
            "announce": None,
        }
        beats = SyntheticSource(waveform.model_copy(update=regular))
        mean_share = -float(beats.take(round(BEATS_S * waveform.rate_hz)).min())
        self._waveform = SyntheticSource(waveform)
        self.channels = (*WristSensors.channels, *self._waveform.channels[1:])
        self._scene, self._pulse_pa = scene, scene.systolic_pa - scene.diastolic_pa
        self._rng = np.random.default_rng([scene.pulse.seed, 1])
        self.period_ns = self._waveform.period_ns
        self.artery = Artery(scene, mean_share)
        self._film_n = self._cell_n = 0.0

    def next_samples(
        self, count: int
    ) -> tuple[list[float], list[list[float]], NDArray[np.float64]]:
        """Return arterial pressures in Pa and noise of the next samples, for `sense`, and the ECG.

        The ECG in mV has the shape (count, 1), or (count, 0) where there is none.
        """
        waveform = self._waveform.take(count)
        pressures_pa = self.artery.mean_pa + self._pulse_pa * waveform[:, 0]
        noise = self._rng.standard_normal((count, 2))
        return pressures_pa.tolist(), noise.tolist(), waveform[:, 1:]

    def sense(self, pressure_pa: float, noise: list[float], force_n: float) -> tuple[float, float]:
        """Return what film and load cell read in N, a period later, for a static force."""
        artery_n = self.artery.pulse_n(pressure_pa, force_n)
        if force_n <= 0.0:
            artery_n = 0.0
        follows = -math.expm1(-self.period_ns * 1e-9 / SENSOR_LAG_S)
        self._film_n += (artery_n - self._film_n) * follows
        self._cell_n += (force_n + artery_n - self._cell_n) * follows
        film_n = self._film_n + self._scene.noise_n * noise[0]
        return film_n, self._cell_n + self._scene.cell_noise_n * noise[1]


class ProbedTissue(SampleSource, PressedProbe):
    """Soft tissue under a probe with a modelled drive, both integrated sample by sample.

    force_n: true static force on the wrist after the last sample.
    """

    channels = WristSensors.channels

    def __init__(self, period_ns: int, limits: ProbeLimits | None, law: StiffeningLaw) -> None:
        self._law, self.period_ns = law, period_ns
        self.probe = Probe(limits or ProbeLimits())
        self._time_ns = 0
        self._speed_m_per_s = self._position_m = 0.0
        self.force_n = 0.0

    @property
    def pressed(self) -> PressedProbe:
        """See `SampleSource.pressed`."""
        return self

    @property
    def depth_m(self) -> float:
        """Depth of the probe in the tissue; negative off the wrist."""
        return self._position_m - CLEARANCE_M

    def press(self, force_n: float) -> None:
        """Take a set-point in N."""
        self.probe.press(force_n, self._time_ns)

    def _move(self, film_n: float, cell_n: float) -> None:
        """Advance probe, drive and tissue by a sample of film and load cell."""
        period_s = self.period_ns * 1e-9
        wanted = self.probe.step(cell_n, film_n, self._position_m, self._time_ns)
        self._speed_m_per_s += (wanted - self._speed_m_per_s) * -math.expm1(-period_s / DRIVE_LAG_S)
        self._position_m += self._speed_m_per_s * period_s
        self.force_n = self._law.force_n(self.depth_m)
        self._time_ns += self.period_ns


class Wrist(ProbedTissue):
    """Source of the channels of a pressed wrist: "pulse" (film), "hold-down" (load cell), and ECG.

    artery: under the probe. pressures_pa: arterial, of the samples that were taken last.
    """

    def __init__(self, scene: WristScene, limits: ProbeLimits | None = None) -> None:
        self._sensors = sensors = WristSensors(scene)
        super().__init__(sensors.period_ns, limits, StiffeningLaw(scene.knee_n, scene.length_m))
        self.artery, self.channels = sensors.artery, sensors.channels
        self.pressures_pa: list[float] = []

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples in N, and the ECG in mV, shape (count, channels)."""
        self.pressures_pa, noise, ecg_mv = self._sensors.next_samples(count)
        rows = [self._step(*each) for each in zip(self.pressures_pa, noise, strict=True)]
        return np.hstack([np.array(rows).reshape(count, 2), ecg_mv])

    def _step(self, pressure_pa: float, noise: list[float]) -> tuple[float, float]:
        film_n, cell_n = self._sensors.sense(pressure_pa, noise, self.force_n)
        self._move(film_n, cell_n)
        return film_n, cell_n
