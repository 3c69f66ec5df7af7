"""Pulses of people: recordings, and drawn pulses with statistics from the literature.

A drawn pulse is made as an artery makes it. The heart ejects a flow of a skewed shape; a
three-element windkessel turns it into a pressure that rises with the flow and runs off
exponentially [1]_; to this comes the wave that is reflected later. A beat's ejection time [2]_ and
stroke follow from the interval before it, in which the heart has filled. So the shape of a beat
gives the next interval away only as far as one interval resembles the next.

Sensors give their own rate, and are not interpolated.

References
----------
.. [1] N. Westerhof, J. Lankhaar, B. Westerhof, "The arterial windkessel", 2009.
.. [2] A. Weissler et al., "Systolic time intervals in heart failure in man", 1968.
.. [3] J. Wang et al., "Time-domain representation of ventricular-arterial coupling as a windkessel
   and wave system", 2003.
.. [4] J. Allen, "Photoplethysmography and its application in clinical physiological measurement",
   2007.
"""

from importlib.util import find_spec
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sensing_node.files.formats import open_signals
from tests.support.drawn_pulses import SCORED_FROM_S, Floats, Pulse, RecordedStretch

# What is drawn before time 0, in which the windkessel and the intervals settle.
LEAD_S: Final = 10.0
DRAWN_HZ: Final = 1000
# Rate and least length of a slow wave, so that its band has many frequencies.
WAVE_HZ: Final = 50
WAVE_S: Final = 300.0
FRAME_S: Final = 0.008
# Bands in Hz: centre and width. Low-frequency as in McSharry et al., "A dynamical model for
# generating synthetic electrocardiogram signals", 2003; the slow one is below 0.04 Hz.
LOW_HZ: Final = (0.1, 0.01)
SLOW_HZ: Final = (0.02, 0.008)
BREATH_WIDTH_HZ: Final = 0.01
MOVEMENT_HZ: Final = (1.5, 0.7)
# Least interval between beats, and time in which the heart fills.
LEAST_S: Final = 0.3
FILLS_S: Final = 0.2
# From a premature ventricular beat's shorter interval, and its stroke over that of a normal beat
# that has filled as much: its ventricles do not contract together.
COUPLING: Final = (0.58, 0.7)
ASYNCHRONY: Final = 0.8
# Range of a wave over one period, in its deviations.
RANGE: Final = 2.5
# Deviation of strokes that follows from nothing, as in recordings.
SCATTER: Final = 0.02
# Characteristic impedance of the aorta over the resistance [1]_.
IMPEDANCE: Final = 0.06
# Above it a wave is hardly reflected.
REFLECTS_HZ: Final = 4.0
# Movements last so long, and come once in this time; so do gaps.
MOVES_S: Final = (2.0, 4.0)
MOVES_EVERY_S: Final = 15.0
GAP_S: Final = (0.1, 0.5)
GAPS_EVERY_S: Final = 10.0


class Shares(NamedTuple):
    """Shares of the intervals' variance at 0.1 Hz and with breathing; the rest is slower."""

    low: float
    breath: float


class Rhythm(NamedTuple):
    """Rhythm of a heart."""

    bpm: float
    #: Standard deviation of the intervals between normal beats.
    sdnn_s: float
    shares: Shares
    breaths_hz: float = 0.25
    #: Range of the strokes within a breath, over their mean; filling and run-off add to that of the
    #: pulse's height.
    strokes: float = 0.06
    #: By how much the rate falls in a minute, and no further.
    falls_bpm: float = 0.0
    #: One beat in so many is premature; 0: none.
    ectopic: int = 0
    #: Rate in Hz at which long intervals become rarer in fibrillation; 0: none.
    fibrillation_hz: float = 0.0


class Artery(NamedTuple):
    """Arteries, and the tissue between them and the sensor."""

    #: Time constant of the run-off towards the pressure at which flow ceases [3]_.
    runoff_s: float = 0.45
    #: Reflected wave over the arriving one, and its delay.
    reflected: float = 0.35
    delay_s: float = 0.25
    #: Above it the tissue lets little through.
    tissue_hz: float = 8.0
    #: Deviation of the height by the tone of small arteries, at 0.1 Hz and slower [4]_.
    tone: float = 0.08


class Sensor(NamedTuple):
    """A sensor; noise, drift (deviations) and movement are over the mean height of a beat."""

    rate_hz: float
    noise: float
    #: Steps of the converter in the height of a beat; 0: none.
    steps: int = 0
    drift: float = 0.02
    movement: float = 0.0
    #: Whether samples are lost.
    gaps: bool = False


class Person(NamedTuple):
    """A person and the sensor that is worn."""

    rhythm: Rhythm
    artery: Artery
    sensor: Sensor


class Ejections(NamedTuple):
    """Ejections of a heart: when each begins and how long it lasts in s, and its volume."""

    onsets_s: Floats
    durations_s: Floats
    #: Over that of a mean beat.
    strokes: Floats


# Shares of the variance (LF, HF) at rest: 1170 and 975 of 3466 ms², Task Force of the ESC and the
# NASPE, "Heart rate variability", 1996; and 519 and 657 of 50² ms², D. Nunan et al., "A
# quantitative systematic review of normal values for short-term heart rate variability", 2010.
TASK_FORCE: Final = Shares(low=0.34, breath=0.28)
NUNAN: Final = Shares(low=0.21, breath=0.26)

PEOPLE: Final = {
    # SDNN 59 ms and its parts: Task Force 1996, 5 min supine.
    "at rest, 250 Hz": Person(
        Rhythm(62, 0.059, TASK_FORCE),
        Artery(runoff_s=0.6, delay_s=0.28, tissue_hz=20, tone=0.03),
        Sensor(250, noise=0.002),
    ),
    # Mean interval 926 ms, SDNN 50 ms and its parts: Nunan 2010.
    "at rest, 100 Hz": Person(
        Rhythm(64.8, 0.050, NUNAN), Artery(), Sensor(100, noise=0.005, steps=400)
    ),
    # Least SDNN of healthy groups, 32 ms: Nunan 2010. Early reflection of stiff arteries: W.
    # Nichols, "Clinical measurement of arterial stiffness", 2005.
    "old, 125 Hz": Person(
        Rhythm(72, 0.032, NUNAN, strokes=0.08),
        Artery(runoff_s=0.4, reflected=0.5, delay_s=0.12),
        Sensor(125, noise=0.003, steps=250),
    ),
    # Greatest SDNN of healthy groups, 93 ms: Nunan 2010.
    "athlete, 50 Hz": Person(
        Rhythm(52, 0.093, Shares(0.25, 0.55), breaths_hz=0.22),
        Artery(runoff_s=0.7, reflected=0.3, delay_s=0.3),
        Sensor(50, noise=0.005, steps=500),
    ),
    # Six breaths a minute join both parts at 0.1 Hz: M. Russo et al., "The physiological effects of
    # slow breathing in the healthy human", 2017.
    "slow breathing, 200 Hz": Person(
        Rhythm(66, 0.100, Shares(0.05, 0.85), breaths_hz=0.1, strokes=0.03),
        Artery(tone=0.02),
        Sensor(200, noise=0.002),
    ),
    # Fall of more than 12 beats in the first minute: C. Cole et al., "Heart-rate recovery
    # immediately after exercise as a predictor of mortality", 1999.
    "after exercise, 100 Hz": Person(
        Rhythm(128, 0.020, TASK_FORCE, breaths_hz=0.4, falls_bpm=25),
        Artery(runoff_s=0.4),
        Sensor(100, noise=0.01),
    ),
    # Height by 17 % with the ventilator, before volume is given: M. Cannesson et al., "Respiratory
    # variations in pulse oximetry plethysmographic waveform amplitude", 2007.
    "ventilated, 125 Hz": Person(
        Rhythm(88, 0.020, Shares(0.1, 0.7), breaths_hz=0.23, strokes=0.12),
        Artery(tissue_hz=20, tone=0.03),
        Sensor(125, noise=0.002, steps=60),
    ),
    # Premature beats with a full compensatory pause; a weak pulse, and a strong one after it.
    "ectopic, 125 Hz": Person(
        Rhythm(70, 0.040, TASK_FORCE, ectopic=12), Artery(), Sensor(125, noise=0.005, steps=250)
    ),
    "trigeminy, 100 Hz": Person(
        Rhythm(74, 0.025, NUNAN, ectopic=3),
        Artery(runoff_s=0.4, reflected=0.45, delay_s=0.16),
        Sensor(100, noise=0.005),
    ),
    # An exponential time at 3 to 12 Hz, and a correlated one: T. Hennig et al., "Exponential
    # distribution of long heart beat intervals during atrial fibrillation", 2006. Together a
    # coefficient of variation of 0.24: K. Tateno, L. Glass, "Automatic detection of atrial
    # fibrillation using the coefficient of variation [...] of RR and ΔRR intervals", 2001.
    "fibrillation, 250 Hz": Person(
        Rhythm(80, 0.180, Shares(0.2, 0.1), fibrillation_hz=7),
        Artery(runoff_s=0.4, reflected=0.45, delay_s=0.15, tissue_hz=20, tone=0.03),
        Sensor(250, noise=0.003),
    ),
    "fibrillation, fast, 50 Hz": Person(
        Rhythm(112, 0.129, Shares(0.2, 0.1), fibrillation_hz=10),
        Artery(runoff_s=0.4),
        Sensor(50, noise=0.01),
    ),
    # 21 to 64 Hz are enough at a wrist: B. Bent, J. Dunn, "Optimizing sampling rate of
    # wrist-worn optical sensors", 2021.
    "watch, 25 Hz": Person(
        Rhythm(68, 0.045, NUNAN, strokes=0.08), Artery(tone=0.15), Sensor(25, noise=0.02, drift=0.1)
    ),
    # The baseline wanders by half the height, as of a cuff or a probe that is not coupled by AC.
    "drift, 64 Hz": Person(
        Rhythm(76, 0.040, TASK_FORCE), Artery(), Sensor(64, noise=0.01, drift=0.5)
    ),
    # Samples lost in gaps of 0.1 to 0.5 s, as of a radio link.
    "gaps, 100 Hz": Person(Rhythm(70, 0.050, NUNAN), Artery(), Sensor(100, noise=0.005, gaps=True)),
    # Movement is of the band of the pulse, 0.1 to 10 Hz: it is felt, and belongs to the truth.
    "movement, 50 Hz": Person(
        Rhythm(78, 0.045, NUNAN), Artery(), Sensor(50, noise=0.01, steps=100, movement=0.4)
    ),
    # A converter of 8 bits, of which a beat takes 20 steps.
    "coarse steps, 75 Hz": Person(
        Rhythm(66, 0.050, NUNAN), Artery(), Sensor(75, noise=0.001, steps=20)
    ),
}
RECORDED: Final = {
    "recorded, at rest, 100 Hz": RecordedStretch("data.csv", 0, 100.0, 0.0),
    "recorded, weak, 117 Hz": RecordedStretch("data2.csv", 1, 117.0, 40.0),
    "recorded, clipped, 100 Hz": RecordedStretch("data3.csv", 1, 100.4, 20.0),
    "recorded, touched, 100 Hz": RecordedStretch("data3.csv", 1, 100.4, 170.0),
    "recorded, still, 100 Hz": RecordedStretch("data3.csv", 1, 100.4, 246.0),
    "recorded, moved, 100 Hz": RecordedStretch("data3.csv", 1, 100.4, 570.0),
}
"""Stretches of the package heartpy; rates from their time stamps, or from its manual (first)."""


def people_pulses(seconds: float, seed: int) -> list[Pulse]:
    """Return the pulses of people: drawn ones, and recordings where heartpy is installed.

    Parameters
    ----------
    seconds
        Length; that of a recording may be less.
    seed
        Seed of what is drawn.

    Raises
    ------
    SourceError
        A recording cannot be read.
    """
    drawn = [
        _sensed(name, person, seconds, np.random.default_rng((seed, 300 + number)))
        for number, (name, person) in enumerate(PEOPLE.items())
    ]
    return drawn + _recorded(seconds)


def _ejections(
    rhythm: Rhythm, seconds: float, rng: np.random.Generator
) -> tuple[Ejections, Floats]:
    """Return ejections from `LEAD_S` before time 0 on, and the wave of breathing at `WAVE_HZ`."""
    length_s = seconds + LEAD_S + 5
    breath = _wave(rng, length_s, rhythm.breaths_hz, BREATH_WIDTH_HZ)
    intervals_s = _intervals(rhythm, length_s - 2.5, breath, rng)
    weak = np.ones(len(intervals_s))
    if rhythm.ectopic:
        weak[_make_premature(intervals_s, rhythm.ectopic, rng) + 1] = ASYNCHRONY
    onsets_s = np.concatenate([[0.0], np.cumsum(intervals_s)[:-1]])
    before_s = np.concatenate([intervals_s[:1], intervals_s[:-1]])
    # In men, by the rate of the heart [2]_.
    durations_s = np.clip(0.413 - 0.0017 * 60 / before_s, 0.16, 0.36)
    fills = 1 - np.exp(-np.maximum(before_s - durations_s, 0.03) / FILLS_S)
    # A quarter of a breath after the intervals: otherwise a stroke would predict its interval.
    lags = breath[((onsets_s - 0.25 / rhythm.breaths_hz) * WAVE_HZ).astype(int)]
    heights = 1 + rhythm.strokes / RANGE * lags + SCATTER * rng.standard_normal(len(lags))
    strokes = weak * heights * fills / fills.mean()
    return Ejections(onsets_s - LEAD_S, durations_s, strokes), breath


def _intervals(rhythm: Rhythm, seconds: float, breath: Floats, rng: np.random.Generator) -> Floats:
    """Return the intervals between beats, without premature ones."""
    low, slow = (_wave(rng, len(breath) / WAVE_HZ, *band) for band in (LOW_HZ, SLOW_HZ))
    shares = rhythm.shares
    varies = shares.low**0.5 * low + shares.breath**0.5 * breath
    varies += (1 - shares.low - shares.breath) ** 0.5 * slow
    varies_s = varies * rhythm.sdnn_s / varies.std()
    exponential_s = 1 / rhythm.fibrillation_hz if rhythm.fibrillation_hz else 0.0
    varies_s *= (1 - (exponential_s / rhythm.sdnn_s) ** 2) ** 0.5
    onset_s, intervals_s = 0.0, []
    while onset_s < seconds:
        falls_bpm = rhythm.falls_bpm * min(max(onset_s - LEAD_S, 0) / 60, 1)
        interval_s = 60 / (rhythm.bpm - falls_bpm) + varies_s[int(onset_s * WAVE_HZ)]
        interval_s += rng.exponential(exponential_s) - exponential_s
        intervals_s.append(max(LEAST_S, interval_s))
        onset_s += intervals_s[-1]
    return np.array(intervals_s)


def _make_premature(intervals_s: Floats, one_in: int, rng: np.random.Generator) -> NDArray[np.int_]:
    """Shorten one interval in `one_in`, lengthen the next one by as much; return which."""
    first = np.arange(0, len(intervals_s) - one_in, one_in)
    short = first + rng.integers(max(1, one_in - 2), size=len(first))
    earlier_s = intervals_s[short] * (1 - rng.uniform(*COUPLING, len(short)))
    intervals_s[short] -= earlier_s
    intervals_s[short + 1] += earlier_s
    return short


def _pressure(ejections: Ejections, artery: Artery, times_s: Floats) -> Floats:
    """Return the pressure at a finger, at times with a spacing of 1 / `DRAWN_HZ`."""
    from scipy.signal import butter, lfilter, sosfilt

    beat = np.searchsorted(ejections.onsets_s, times_s, "right") - 1
    durations_s = ejections.durations_s[beat]
    phase = np.clip((times_s - ejections.onsets_s[beat]) / durations_s, 0, 1)
    flow = ejections.strokes[beat] / durations_s * 12 * phase * (1 - phase) ** 2
    falls = np.exp(-1 / (DRAWN_HZ * artery.runoff_s))
    reservoir = lfilter([1 - falls], [1, -falls], flow - flow.mean())
    pressure = reservoir + IMPEDANCE * flow
    returned = sosfilt(butter(2, REFLECTS_HZ, fs=DRAWN_HZ, output="sos"), pressure)
    delay = round(artery.delay_s * DRAWN_HZ)
    pressure[delay:] += artery.reflected * returned[:-delay]
    return np.asarray(sosfilt(butter(2, artery.tissue_hz, fs=DRAWN_HZ, output="sos"), pressure))


def _sensed(name: str, person: Person, seconds: float, rng: np.random.Generator) -> Pulse:
    """Return the pulse of a person as the sensor gives it."""
    sensor = person.sensor
    ejections, breath = _ejections(person.rhythm, seconds, rng)
    drawn_s = np.arange(-round(LEAD_S * DRAWN_HZ), round(seconds * DRAWN_HZ)) / DRAWN_HZ
    pressure = _pressure(ejections, person.artery, drawn_s)
    height = _height(pressure, ejections.onsets_s, drawn_s)
    times_s = np.arange(0, seconds - 1 / DRAWN_HZ, 1 / sensor.rate_hz)
    waves_s = np.arange(len(breath)) / WAVE_HZ - LEAD_S
    tone, tones, wanders = (
        _wave(rng, len(breath) / WAVE_HZ, *band) for band in (LOW_HZ, SLOW_HZ, SLOW_HZ)
    )
    tone = 1 + person.artery.tone / np.sqrt(2) * np.interp(times_s, waves_s, tone + tones)
    true = np.interp(times_s, drawn_s, pressure) / height * tone
    true += sensor.drift / np.sqrt(2) * np.interp(times_s, waves_s, breath + wanders)
    if sensor.movement:
        moves = _wave(rng, len(breath) / WAVE_HZ, *MOVEMENT_HZ)
        moves = np.interp(times_s, waves_s, moves)
        true += sensor.movement * moves * _bursts(times_s, MOVES_EVERY_S, MOVES_S, rng)
    sensed = true + sensor.noise * rng.standard_normal(len(true))
    if sensor.steps:
        sensed = np.round(sensed * sensor.steps) / sensor.steps
    if sensor.gaps:
        sensed[_bursts(times_s, GAPS_EVERY_S, GAP_S, rng) > 0] = np.nan
    level, scale = _moments(true, sensor.rate_hz)
    sensed, true = (sensed - level) / scale, (true - level) / scale
    return Pulse(name, sensed, true, sensor.rate_hz, _frame(sensor.rate_hz))


def _height(pressure: Floats, onsets_s: Floats, times_s: Floats) -> float:
    """Return the mean rise of the beats from time 0 on."""
    begins = np.searchsorted(times_s, onsets_s[(onsets_s >= 0) & (onsets_s < times_s[-1])])
    rises = np.maximum.reduceat(pressure, begins) - pressure[begins]
    return float(rises[:-1].mean())


def _wave(rng: np.random.Generator, length_s: float, centre_hz: float, width_hz: float) -> Floats:
    """Return noise at `WAVE_HZ` around a frequency, with a mean of 0 and a deviation of 1."""
    count = round(length_s * WAVE_HZ)
    frequencies_hz = np.fft.rfftfreq(max(count, round(WAVE_S * WAVE_HZ)), 1 / WAVE_HZ)
    levels = np.exp(-0.25 * ((frequencies_hz - centre_hz) / width_hz) ** 2)
    levels[0] = 0
    phases = rng.uniform(0, 2 * np.pi, len(levels))
    wave = np.fft.irfft(levels * np.exp(1j * phases))[:count]
    return np.asarray((wave - wave.mean()) / wave.std())


def _bursts(
    times_s: Floats, every_s: float, lasts_s: tuple[float, float], rng: np.random.Generator
) -> Floats:
    """Return a rise and fall from 0 to 1, once in `every_s` at a random time."""
    bursts = np.zeros(len(times_s))
    for first_s in np.arange(0, times_s[-1], every_s):
        length_s = rng.uniform(*lasts_s)
        phase = (times_s - first_s - rng.uniform(0, every_s - length_s)) / length_s
        bursts += np.where((phase > 0) & (phase < 1), np.sin(np.pi * phase) ** 2, 0)
    return bursts


def _recorded(seconds: float) -> list[Pulse]:
    """Return the recordings of the package heartpy; none where it is not installed."""
    package = find_spec("heartpy")
    if package is None or package.origin is None:
        return []
    folder, columns, pulses = Path(package.origin).parent / "data", {}, []
    for name, (file, column, rate_hz, from_s) in RECORDED.items():
        if file not in columns:
            columns[file] = open_signals(folder / file).load((column,))[0].values
        values = columns[file][round(from_s * rate_hz) :][: round(seconds * rate_hz)]
        level, scale = _moments(values, rate_hz)
        values = (values - level) / scale
        pulses.append(Pulse(name, values, values, rate_hz, _frame(rate_hz)))
    return pulses


def _frame(rate_hz: float) -> int:
    return max(1, round(FRAME_S * rate_hz))


def _moments(values: Floats, rate_hz: float) -> tuple[float, float]:
    """Return mean and deviation where errors are counted; of all, if it ends before."""
    first = round(SCORED_FROM_S * rate_hz)
    scored = values[first:] if first < len(values) else values
    return float(scored.mean()), float(scored.std())
