"""Beats of a recorded wrist that was pressed, by their hold-down. Pure."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.beat_quality import BeatShape
from display_node.scoring.beats import Beat
from display_node.scoring.depth_curve import BeatPoint
from display_node.scoring.pressed_beats import (
    SteadyAnalysis,
    beat_shape,
    judge_beat,
    measure_beat,
    steady_hold_down_n,
)
from protocol.wire.messages import Frame

# A beat is measured with the samples around it, which reach beyond its shape.
AROUND_NS = 3_000_000_000
# Share of a beat's samples that have arrived.
WHOLE = 0.9
Floats = NDArray[np.float64]


class SteadyBeat(NamedTuple):
    """A beat at a steady hold-down: its measures, its shape, and the samples around it."""

    beat: Beat
    point: BeatPoint
    shape: BeatShape
    times_ns: Floats
    pulse_n: Floats


def find_steady_beats(frames: Sequence[Frame], pulse: int, cell: int) -> list[SteadyBeat]:
    """Return those beats of a session that are whole, at a hold-down that was steady.

    frames: in order of time. pulse, cell: numbers of the channels of the pulse, and of the pulse
    with the hold-down.
    """
    analysis, beats = SteadyAnalysis(), list[Beat]()
    times, pulses, held = list[int](), list[Floats](), list[Floats]()
    for frame in frames:
        samples, values = frame.samples_of(pulse), frame.values.astype(np.float64)
        times += samples.times_ns
        pulses.append(values[:, pulse])
        held.append(values[:, cell] - values[:, pulse])
        beats += analysis.observe(samples, float(held[-1].mean()))
    if not beats:
        return []
    # Sensing clocks are whole numbers of ns, which floats hold exactly for a hundred days.
    times_ns, pulse_n, held_n = np.array(times, float), np.concatenate(pulses), np.concatenate(held)
    found: list[SteadyBeat] = []
    for beat in beats:
        end_ns = beat.onset_ns + round(beat.interval_s * 1e9)
        first, last = np.searchsorted(times_ns, [beat.onset_ns, end_ns])
        begin, end = np.searchsorted(times_ns, [beat.onset_ns - AROUND_NS, end_ns + AROUND_NS])
        around_ns, around_n = times_ns[begin:end], pulse_n[begin:end]
        shape = beat_shape(beat, around_ns, around_n)
        if shape is None or (last - first) * frames[0].period_ns < WHOLE * 1e9 * beat.interval_s:
            continue
        force_n = steady_hold_down_n(held_n[first:last])
        if force_n is not None:
            point = measure_beat(beat, around_ns, around_n, force_n)
            found.append(SteadyBeat(beat, point, shape, around_ns, around_n))
    return found


def judge_beats(beats: Sequence[SteadyBeat]) -> list[SteadyBeat]:
    """Return beats in the order of their hold-down, judged by their neighbours, which are alike."""
    ordered = sorted(beats, key=lambda each: each.point.hold_down_n)
    points, shapes = [each.point for each in ordered], [each.shape for each in ordered]
    return [
        each._replace(point=each.point._replace(quality=judge_beat(number, points, shapes)))
        for number, each in enumerate(ordered)
    ]
