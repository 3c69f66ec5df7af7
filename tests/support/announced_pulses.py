"""Pulses with an ECG, what can go wrong with one, and the prediction of such pulses."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from display_node.prediction.ensemble import Ensemble
from display_node.prediction.r_waves import RWaveDetector
from sensing_node.sources.heart import draw_ecg
from tests.support.drawn_pulses import (
    FRAME,
    HORIZONS_MS,
    RATE_HZ,
    Beats,
    Floats,
    Pulse,
    drawn_beats,
    instant_ns,
    observe_frame,
    pulses,
    pulses_without_shape_cue,
)

TRANSIT_S = 0.18
# RMS noise of the ECG in mV.
NOISE_MV = 0.02
SYNTHETIC = ("variability", "ectopic", "fibrillation")
SHAPE_CUE = "shape cue"


class AnnouncedPulse(NamedTuple):
    """A pulse, and the ECG in mV at the same rate."""

    pulse: Pulse
    ecg_mv: Floats

    def __str__(self) -> str:
        return str(self.pulse)


def announce(pulse: Pulse, beats: Beats, jitter_s: float, seed: int) -> AnnouncedPulse:
    """Add an ECG whose R waves precede the onsets by the transit time, with a random deviation."""
    rng = np.random.default_rng((seed, 200))
    onsets_s = beats.onsets_s
    waves_s = onsets_s - TRANSIT_S + jitter_s * rng.standard_normal(len(onsets_s))
    t_s = np.arange(len(pulse.sensed)) / RATE_HZ
    ecg_mv = draw_ecg(t_s, [(each, 1.0) for each in waves_s.tolist()])
    return AnnouncedPulse(pulse, ecg_mv + NOISE_MV * rng.standard_normal(len(t_s)))


def announced_pulses(seconds: float, seed: int, jitter_s: float) -> list[AnnouncedPulse]:
    """Return variability, ectopic beats and fibrillation, without and with a shape cue.

    With a shape cue, a beat's shape follows its own interval (`drawn`).
    """
    beats = drawn_beats(seconds, seed)
    silent = {each.name: each for each in pulses_without_shape_cue(seconds, seed)}
    cued = {each.name: each for each in pulses(seconds, seed)}
    made = [announce(silent[name], beats[name], jitter_s, seed) for name in SYNTHETIC]
    for name in SYNTHETIC:
        pulse = Pulse(f"{name}, {SHAPE_CUE}", cued[name].sensed, cued[name].true)
        made.append(announce(pulse, beats[name], jitter_s, seed))
    return made


class EcgFault(NamedTuple):
    """Change of an ECG from an index on."""

    name: str
    apply: Callable[[Floats, int, np.random.Generator], Floats]


def _another_heart(ecg_mv: Floats, first: int, rng: np.random.Generator) -> Floats:
    intervals_s = 0.83 * (1 + 0.05 * rng.standard_normal(200))
    t_s = np.arange(len(ecg_mv) - first) / RATE_HZ
    return draw_ecg(t_s, [(each, 1.0) for each in np.cumsum(intervals_s).tolist()])


JUMP = "jumps 0.1 s"
FAULTS = (
    EcgFault("another heart's", _another_heart),
    EcgFault("0.3 s late", lambda ecg, first, rng: ecg[first - 300 : -300]),
    EcgFault(
        "noise of 1 mV", lambda ecg, first, rng: ecg[first:] + rng.standard_normal(len(ecg) - first)
    ),
    EcgFault("unplugged", lambda ecg, first, rng: 0.01 * rng.standard_normal(len(ecg) - first)),
    EcgFault(JUMP, lambda ecg, first, rng: ecg[first - 100 : -100]),
)


def with_fault(announced: AnnouncedPulse, fault: EcgFault, from_s: float) -> AnnouncedPulse:
    """Return the pulse with an ECG that is wrong from a time on."""
    first = round(from_s * RATE_HZ)
    wrong = fault.apply(announced.ecg_mv, first, np.random.default_rng(3))
    ecg_mv = np.concatenate([announced.ecg_mv[:first], wrong])
    return AnnouncedPulse(announced.pulse, ecg_mv)


class AnnouncedRun(NamedTuple):
    """A run of the predictor: squared errors by frame and horizon, and by frame, whether used."""

    squares: Floats
    used: Floats
    stack: Ensemble


def run(announced: AnnouncedPulse, with_ecg: bool) -> AnnouncedRun:
    """Predict a pulse frame by frame, with or without its ECG.

    After each frame, one prediction is made for each horizon, as in the benchmark `prediction`.
    """
    pulse, ecg_mv = announced
    stack, detector = Ensemble("stack"), RWaveDetector()
    count = (len(pulse.true) - max(HORIZONS_MS) * RATE_HZ // 1000) // FRAME - 1
    squares, used = np.zeros((count, len(HORIZONS_MS))), np.zeros(count)
    for frame in range(count):
        observe_frame(stack, pulse.sensed, frame)
        if with_ecg:
            stack.announce(observe_frame(detector, ecg_mv, frame))
        transit = stack.transit
        used[frame] = transit is not None and transit.reliable
        for tick in range(FRAME):
            stack.work()
            if tick == frame % FRAME:
                newest = frame * FRAME + FRAME - 1
                at = [newest + horizon_ms * RATE_HZ // 1000 for horizon_ms in HORIZONS_MS]
                found = np.array([stack.predict(instant_ns(each)) for each in at])
                squares[frame] = (found - pulse.true[at]) ** 2
    return AnnouncedRun(squares, used, stack)


def nrmse(squares: Floats, from_s: float, to_s: float = np.inf) -> tuple[float, ...]:
    """Return the root mean square at each horizon between two times."""
    frames = np.arange(len(squares)) * FRAME / RATE_HZ
    chosen = squares[(frames >= from_s) & (frames < to_s)]
    return tuple(np.sqrt(chosen.mean(axis=0)).tolist())
