"""Signals for predictors, which are fed as in a display."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from display_node.prediction import Predictor
from display_node.prediction.expert import AHEAD, SPACING, Expert
from display_node.prediction.history import History

MS = 1_000_000
T0_NS = 7_000 * MS
BEAT_S = 0.8
Floats = NDArray[np.float64]


def beats(t_s: Floats, intervals_s: Sequence[float] = (BEAT_S,)) -> Floats:
    """Return a pulse of unit size with two waves in each beat, whose intervals recur."""
    onset_s, pulse, beat = -BEAT_S, np.zeros(len(t_s)), 0
    while onset_s < t_s[-1] + 1:
        for amplitude, centre_s, width_s in ((3.0, 0.14, 0.045), (1.5, 0.3, 0.055)):
            pulse += amplitude * np.exp(-0.5 * ((t_s - onset_s - centre_s) / width_s) ** 2)
        onset_s += intervals_s[beat % len(intervals_s)]
        beat += 1
    return pulse - 0.8


def expert_errors(expert: Expert, signal: Floats, from_step: int) -> Floats:
    """Return the largest error of an expert's trajectories at each horizon, from a step on."""
    history = History(8_192)
    made, worst = np.zeros((len(expert.names), 1, len(AHEAD))), np.zeros((len(expert.names), 25))
    for step, value in enumerate(signal.tolist()):
        history.push(value)
        expert.predict(history, made)
        expert.prepare(history)
        if step % SPACING == 0:
            expert.learn(history)
        if from_step <= step < len(signal) - AHEAD[-1]:
            worst = np.maximum(worst, np.abs(value + made[:, 0] - signal[step + AHEAD]))
    return worst


def feed(
    predictor: Predictor, values: Floats, first: int = 0, period_ns: int = MS, frame: int = 5
) -> None:
    """Feed frames of samples, and do all the work of each."""
    for start in range(0, len(values) - frame + 1, frame):
        numbers = range(first + start, first + start + frame)
        times_ns = [T0_NS + number * period_ns for number in numbers]
        predictor.observe(times_ns, values[start : start + frame].tolist())
        while predictor.work():
            pass
