"""The sensing-side chain between the film and the frames, simulated on a source's samples.

force → film volts → charge amplifier → mains notch → anti-alias filter → ADC → inverse
calibration → + hold-down force. Parts that the scene does not name are left out.
"""

from typing import Annotated, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.config.quantities import Hertz, Newtons, Volts, count_text
from protocol.errors import SceneError
from protocol.summary.fields import Limits
from protocol.tactile import Adc
from protocol.ticks import LimitCounter
from pulse_sensors.force_scale import SensitivityTable
from sensing_node.sources.source import SampleSource
from sensing_node.sources.synthetic import PRESETS

# The chain's delay is computed for the pulse of Dargahi et al. (2008), the paper, which has next
# to no energy above 40 Hz.
DELAY_BAND_HZ, DELAY_STEP_HZ = 40.0, 0.05


class ConditioningScene(SensitivityTable):
    """The `conditioning` table; stages without a key are left out.

    sensitivity: that of the film with its amplifier (44 mV/N in Fig. 4 of Dargahi et al. 2008); or
    film_radius, with eq 21. charge_amplifier: corner of its high-pass, which removes the static
    force. hold_down: constant force added in its place, so that the display presses. mains:
    frequency of the notch. mains_quality: the notch's frequency over its width. A wide notch
    rejects a varying mains frequency, and delays the pulse more. anti_alias: corner of a
    Butterworth low-pass. adc_bits: resolution over ±adc_range.
    """

    charge_amplifier_hz: Annotated[Hertz, Field(ge=1e-3, le=5)] | None = None
    hold_down_n: Annotated[Newtons, Field(ge=0, le=10)] | None = None
    mains_hz: Annotated[Hertz, Field(ge=45, le=65)] | None = None
    mains_quality: Annotated[float, Field(ge=1, le=100)] = 10.0
    anti_alias_hz: Annotated[Hertz, Field(ge=1, le=50_000)] | None = None
    anti_alias_order: Annotated[int, Field(ge=1, le=8)] = 4
    adc_bits: Annotated[int, Field(ge=2, le=32)] | None = None
    adc_range_v: Annotated[Volts, Field(ge=1e-6, le=1000)] = 10.0

    @model_validator(mode="after")
    def _is_whole(self) -> Self:
        for key, needed in (
            ("hold_down", "charge_amplifier"),
            ("mains_quality", "mains"),
            ("anti_alias_order", "anti_alias"),
            ("adc_range", "adc_bits"),
        ):
            if key in self.given and needed not in self.given:
                raise ValueError(f"{key} needs {needed}, which is not given")
        if self.charge_amplifier_hz is not None and self.hold_down_n is None:
            raise ValueError(
                "charge_amplifier loses the static force; give hold_down, such as"
                ' "0.3 N", for the display to press with in its place'
            )
        return self

    def ideal_film(self) -> "ConditioningScene":
        """Return the chain of an ideal film: the charge amplifier and the hold-down force alone."""
        return self.model_copy(update={"mains_hz": None, "anti_alias_hz": None, "adc_bits": None})


class Conditioned(SampleSource):
    """A source with the chain applied; the filters start settled at the source's first sample.

    Each channel of force has a chain of its own. A channel that announces passes unchanged.

    With a charge amplifier, the first sample is hold_down, and the mean approaches hold_down within
    a few time constants.

    Attributes
    ----------
    group_delay_ns : int
        Delay of the pulse by notch and low-pass (`pulse_delay_s`). The charge amplifier is not
        included: it distorts slow waves, but does not delay the upstroke.

    Raises
    ------
    SceneError
        If a corner is not below half the source's rate.
    """

    def __init__(self, source: SampleSource, scene: ConditioningScene) -> None:
        rate_hz = 1e9 / source.period_ns
        self._source = source
        self._calibration = scene.calibration()
        self._hold_down_n = scene.hold_down_n or 0.0
        high_pass, delaying = _design(scene, rate_hz)
        self._filter = np.concatenate([high_pass, delaying])
        self._state: NDArray[np.float64] | None = None
        self._adc = None if scene.adc_bits is None else Adc(scene.adc_bits, scene.adc_range_v)
        self.group_delay_ns = round(pulse_delay_s(delaying, rate_hz) * 1e9)
        self.period_ns = source.period_ns
        self.channels = source.channels
        self.repeats_after_s = source.repeats_after_s
        self._pulses = [n for n, channel in enumerate(self.channels) if not channel.announces]
        self._clipped = LimitCounter()
        self._clipped_in = np.zeros(len(self._pulses), np.int64)
        self._taken = 0

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples, as a source does."""
        values = self._source.take(count)
        if not len(values):
            return values
        if len(self._pulses) == len(self.channels):
            return self._condition(values)
        conditioned = values.copy()
        conditioned[:, self._pulses] = self._condition(values[:, self._pulses])
        return conditioned

    def _condition(self, force_n: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the next samples of all channels of force, after the chain."""
        volts = self._calibration.volts(force_n)
        if len(self._filter):
            from scipy.signal import sosfilt, sosfilt_zi

            if self._state is None:
                self._state = sosfilt_zi(self._filter)[:, :, np.newaxis] * volts[0]
            volts, self._state = sosfilt(self._filter, volts, axis=0, zi=self._state)
        self._taken += len(force_n)
        if self._adc is not None:
            clips = np.asarray(self._adc.clips(volts))
            self._clipped.add_all(np.asarray(clips.any(axis=1)))
            self._clipped_in += clips.sum(axis=0)
            volts = self._adc.quantise(volts)
        return self._calibration.newtons(volts) + self._hold_down_n

    def notes(self) -> list[str]:
        """Return the notes on the source and on the chain, one line each."""
        notes = self._source.notes()
        if self._clipped.ticks:
            clipped = f"{count_text(self._clipped.ticks, 'sample')} beyond the ADC's range"
            if len(self._pulses) > 1:
                counts = zip(self._pulses, self._clipped_in.tolist(), strict=True)
                clipped += ": " + ", ".join(f"{self.channels[n].name} {c}" for n, c in counts if c)
            notes.append(clipped)
        return notes

    def limits(self) -> Limits:
        """Return how often and for how long the ADC's range has bounded the samples."""
        if self._adc is None:
            return Limits()
        return Limits(adc=self._clipped.limited(self.period_ns * 1e-9, self._taken))


def pulse_delay_s(sections: NDArray[np.float64], rate_hz: float) -> float:
    """Return the time by which second-order sections H delay the paper's pulse, in s.

    The mean of the phase delay −φ/ω over the pulse's spectrum S, weighted by ω² |S|² |H|. Shifting
    the output by this mean minimises its RMSE against the input, as long as the remaining phase
    is small. S is the spectrum of one beat at 75 /min; pulses with another spectrum are delayed a
    little differently.
    """
    if not len(sections):
        return 0.0
    from scipy.signal import sosfreqz

    frequency_hz = np.arange(DELAY_STEP_HZ, min(DELAY_BAND_HZ, rate_hz / 2), DELAY_STEP_HZ)
    omega = 2 * np.pi * frequency_hz
    beat = sum(
        wave.amplitude
        * wave.width_s
        * np.exp(-0.5 * (omega * wave.width_s) ** 2 - 1j * omega * wave.centre_s)
        for wave in PRESETS["paper"]
    )
    _, response = sosfreqz(sections, frequency_hz, fs=rate_hz)
    weight = np.abs(beat) ** 2 * np.abs(response)
    phase_rad = np.unwrap(np.angle(response))
    return float(-(weight * omega * phase_rad).sum() / (weight * omega**2).sum())


def _design(
    scene: ConditioningScene, rate_hz: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the second-order sections of the charge amplifier, and those that delay the pulse.

    They are analogue filters after the prewarped bilinear transform: exact at their corner, the
    notch at its centre and width. Towards half the rate they reject more than analogue filters.
    """
    from scipy.signal import butter, iirnotch, tf2sos

    for key in ("charge_amplifier", "mains", "anti_alias"):
        corner_hz = getattr(scene, f"{key}_hz")
        if corner_hz is not None and corner_hz >= rate_hz / 2:
            raise SceneError(
                f"[sensing.conditioning] {key}: {corner_hz:g} Hz is not below half the source's"
                f" rate, {rate_hz / 2:g} Hz; lower it or leave it out"
            )
    high_pass, delaying = np.empty((0, 6)), np.empty((0, 6))
    if scene.charge_amplifier_hz is not None:
        high_pass = butter(1, scene.charge_amplifier_hz, "highpass", fs=rate_hz, output="sos")
    if scene.mains_hz is not None:
        delaying = tf2sos(*iirnotch(scene.mains_hz, scene.mains_quality, fs=rate_hz))
    if scene.anti_alias_hz is not None:
        order, corner_hz = scene.anti_alias_order, scene.anti_alias_hz
        low_pass = butter(order, corner_hz, fs=rate_hz, output="sos")
        delaying = np.concatenate([delaying, low_pass])
    return high_pass, delaying
