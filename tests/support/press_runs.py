"""Runs of the press in virtual time, each with its scores, for tests and benchmarks.

A finger steps between forces every 4 s. Scored are: the hold-down against the press, the height of
the felt pulse against that which the present press would give, what swings on in the set-point
after a step, the gain of the opened loop, forces and slews, and the time to ease off.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.press.sweep import CLOSED
from protocol.summary.fields import SetPointCounts
from protocol.wire.messages import SetPoint
from sensing_node.press.probe import ProbeLimits
from sensing_node.press.set_points import SetPointServer
from sensing_node.sources.wrist import Wrist
from tests.support.press_loop import (
    AHEAD_NS,
    OWN_PULSE,
    PRESS,
    SESSION,
    TICK_NS,
    Meant,
    PressLoop,
    PressSetting,
    PressTrace,
    link_of,
    wrist_scene,
)

LEVELS_N: Final = (0.6, 1.2, 0.9, 1.5, 0.7, 1.3, 0.8, 1.1, 1.4, 1.0)
STEP_S: Final = 4.0
# A hand takes this long for a step.
RISE_S: Final = 0.08
LEARNT_S: Final = 30.0
# Bars: the hold-down after this time and the round trip, and its error; the height's error; the
# gain; the time to ease off.
FOLLOWED_S, FOLLOW_ERROR, HEIGHT_ERROR = 0.3, 0.05, 0.1
MOST_GAIN, EASED_S = 0.1, 0.5
# Band in which a set-point that swings on would have its energy, and windows after a step.
BAND_HZ: Final = (0.2, 10.0)
WINDOW_S, WINDOWS = 4.0, 4
# Deviation of a set-point at rest, by the noise of the sensor.
REST_N: Final = 3e-3
BEAT_TICKS, FRAME_TICKS = 800, 5
# A height is taken of means over this time, so that the film's noise is not a part of it, and over
# this multiple of a beat.
MEAN_TICKS, OVER_BEATS = 20, 1.2
Floats = NDArray[np.float64]
# A practitioner presses a new wrist at each level first; each for this time.
VISIT_S: Final = 3.0
# Runs with other stiffnesses of tissue and finger: their length.
STIFF_S: Final = 48.0


class FollowScore(NamedTuple):
    """Errors of one run that followed the finger's steps.

    late: largest error of the hold-down FOLLOWED_S and a round trip after each step, as a share of
    the press. heights: relative errors of the felt pulse's height. gain: largest measured gain.
    """

    late: tuple[float, ...]
    heights: tuple[float, ...]
    gain: float
    greatest_n: float
    slew_n_per_s: float
    account: SetPointCounts

    @property
    def beyond(self) -> float:
        """Share of the heights beyond the criterion."""
        return sum(abs(height) > HEIGHT_ERROR for height in self.heights) / len(self.heights)


class SwingScore(NamedTuple):
    """RMS of the set-point within `BAND_HZ`, in windows after a step, in N."""

    rms_n: tuple[float, ...]
    greatest_n: float
    slew_n_per_s: float

    @property
    def decays(self) -> bool:
        """True if no later window has more than the one before, or than a set-point at rest."""
        pairs = zip(self.rms_n, self.rms_n[1:], strict=False)
        return all(later <= max(earlier, REST_N) for earlier, later in pairs)


def steps(time_s: float, levels_n: Sequence[float] = LEVELS_N) -> float:
    """Return the force that the hand means at a time: a step every `STEP_S`."""
    number = int(time_s / STEP_S)
    after = levels_n[number % len(levels_n)]
    before = levels_n[(number - 1) % len(levels_n)] if number else 0.0
    part = min(1.0, (time_s - number * STEP_S) / RISE_S)
    return before + (after - before) * (0.5 - 0.5 * math.cos(math.pi * part))


def follow(setting: PressSetting, seconds: float) -> FollowScore:
    """Run steps of a finger, and score those after `LEARNT_S`."""
    loop = PressLoop(setting, steps if setting.pulse == OWN_PULSE else _visit_then_step(setting))
    trace = loop.run(seconds)
    late, heights = [], []
    beat = MEAN_TICKS * round(OVER_BEATS * _ticks(1 / setting.pulse.heart_rate_hz) / MEAN_TICKS)
    wait_s = FOLLOWED_S + 2e-9 * setting.link.delay_ns
    for number in range(math.ceil(LEARNT_S / STEP_S), int(seconds / STEP_S)):
        begin, end = _ticks(number * STEP_S), _ticks((number + 1) * STEP_S)
        settled = slice(begin + _ticks(wait_s), end)
        late.append(_largest(trace.hold_down_n[settled] / trace.press_n[settled] - 1))
        for at in range(begin + _ticks(RISE_S), end - beat, BEAT_TICKS // 4):
            window = slice(at, at + beat)
            heights.append(_height(trace.pulse_n[window]) / _height(trace.truth_n[window]) - 1)
    gain, account = float(trace.loop_gain.max()), loop.press.sender.counts()
    return FollowScore(tuple(late), tuple(heights), gain, *_peaks(trace), account)


def _visit_then_step(setting: PressSetting) -> Meant:
    """Return a hand that presses with each level in turn while it learns, and then steps.

    The levels lie between the forces at which the wrist's pulse has `CLOSED` of its largest height;
    a sweep presses no further either.
    """
    artery = Wrist(wrist_scene(setting)).artery
    forces_n = np.arange(0.1, 3.0, 5e-3)
    heights = np.array([artery.height_n(force_n) for force_n in forces_n])
    low_n, *_, high_n = forces_n[heights >= CLOSED * heights.max()]
    scale = (high_n - low_n) / (max(LEVELS_N) - min(LEVELS_N))
    levels_n = [float(low_n + scale * (level_n - min(LEVELS_N))) for level_n in LEVELS_N]
    visits_n = sorted(levels_n)

    def meant(time_s: float) -> float:
        if time_s >= math.ceil(LEARNT_S / STEP_S) * STEP_S:
            return steps(time_s, levels_n)
        # The last visit lasts until the first step that counts.
        number = min(int(time_s / VISIT_S), len(visits_n) - 1)
        before = visits_n[number - 1] if number else 0.0
        part = min(1.0, (time_s - number * VISIT_S) / RISE_S)
        return before + (visits_n[number] - before) * (0.5 - 0.5 * math.cos(math.pi * part))

    return meant


def hold_down_error(setting: PressSetting) -> float:
    """Return the largest error of the hold-down after the finger's steps."""
    return max(follow(setting, STIFF_S).late)


def swing(setting: PressSetting) -> SwingScore:
    """Let a finger step, then press constantly; return what swings on in the set-point."""
    from scipy.signal import butter, sosfiltfilt

    begin_s = 5 * STEP_S

    def meant(time_s: float) -> float:
        return steps(min(time_s, begin_s + STEP_S - 1e-3))

    settle_s = 2e-9 * setting.link.delay_ns + 0.5
    trace = PressLoop(setting, meant).run(begin_s + settle_s + WINDOWS * WINDOW_S)
    band = butter(2, BAND_HZ, "bandpass", fs=1e9 / TICK_NS, output="sos")
    # The step itself is left out: its spectrum would be in each window.
    after = trace.set_point_n[_ticks(begin_s + settle_s) :]
    filtered = sosfiltfilt(band, after - after[-1])
    windows = filtered[: WINDOWS * _ticks(WINDOW_S)].reshape(WINDOWS, -1)
    return SwingScore(tuple(np.sqrt((windows**2).mean(axis=1)).tolist()), *_peaks(trace))


def open_gain(setting: PressSetting) -> tuple[float, float]:
    """Return the gain of the opened loop, measured, and the bound that the finger measured itself.

    The wrist is pressed with steps of its own, and the finger means a constant force. The gain is
    the change of its set-point over that of the hold-down.
    """
    levels_n = 0.8, 1.2, 0.7, 1.4
    forces = partial(steps, levels_n=levels_n)
    loop = PressLoop(replace(setting, open_loop=forces), lambda time_s: 1.0)
    trace = loop.run(60.0)
    gains = []
    for number in range(4, int(60.0 / STEP_S) - 1):
        at = _ticks(number * STEP_S)
        change_n = trace.hold_down_n[at + _ticks(STEP_S) - 1] - trace.hold_down_n[at - 1]
        window = trace.set_point_n[at : at + _ticks(STEP_S)]
        before = trace.set_point_n[at - BEAT_TICKS : at].mean()
        gains.append(_largest(window - before) / abs(change_n))
    return float(max(gains)), float(trace.loop_gain[_ticks(4 * STEP_S) :].max())


def ease_off(setting: PressSetting) -> float:
    """Return the time from the last set-point that arrives before a cut until the wrist is free.

    Free: within 0.05 N of the resting force. The cut lasts to the end of the run.
    """
    loop = PressLoop(setting, lambda time_s: 2.5)
    trace, limits = loop.run(8.0), ProbeLimits()
    last = loop.arrived_ns // TICK_NS
    held = np.flatnonzero(trace.hold_down_n[last:] > limits.resting_n + 0.05)
    return float(held[-1]) * TICK_NS * 1e-9 if len(held) else 0.0


def be_hostile(tissue: float) -> tuple[float, float]:
    """Return force and slew at the wrist while a hostile display holds the permission to press."""
    random = np.random.default_rng(5)
    forces = [0.0, 1e6, 0.1, 3.0, 1e-300]

    def intrude(now_ns: int) -> list[SetPoint]:
        number = now_ns // TICK_NS
        numbers = [number, number, max(0, number - 7), number + 3]
        # In turns at random, and all or nothing for 0.3 s.
        jumps = [[1e6], [0.0], forces][now_ns // 300_000_000 % 3]
        return [
            SetPoint(SESSION, press, each, now_ns + AHEAD_NS, 10**10, float(random.choice(jumps)))
            for press in (PRESS + 1, PRESS + 2)
            for each in numbers
        ]

    trace = PressLoop(PressSetting(link_of(0.0), tissue), steps, intrude).run(20.0)
    return _peaks(trace)


class HostileWrist(Wrist):
    """A wrist whose film and load cell read anything, for 5 s each: random, none, and opposite."""

    def take(self, count: int) -> Floats:
        """Return the next samples in N, as `Wrist.take`."""
        values, seconds = super().take(count), self._time_ns // 1_000_000_000
        random = np.random.default_rng(seconds)
        if seconds < 5:
            return values
        size = (1.0, 9e5, 0.0)[seconds // 5 % 3]
        return values + size * random.choice([-1.0, 1.0], values.shape)


def be_hostile_to_the_finger() -> tuple[float, float]:
    """Return the greatest force and slew of the set-points that a finger sends to such a wrist."""
    setting = PressSetting(link_of(0.1))
    loop = PressLoop(setting, partial(steps, levels_n=(0.5, 6.0, 1.0, 2.5)))
    loop.wrist = HostileWrist(wrist_scene(setting))
    loop.server = SetPointServer(SESSION, loop.wrist)
    sent_n = loop.run(30.0).set_point_n
    # Over 40 ms: two set-points.
    return float(sent_n.max()), _largest(sent_n[40:] - sent_n[:-40]) / 0.04


def _ticks(seconds: float) -> int:
    return round(seconds * 1e9 / TICK_NS)


def _largest(values: Floats) -> float:
    return float(np.abs(values).max())


def _height(pulse_n: Floats) -> float:
    """Return the height over a beat, of means."""
    means = pulse_n.reshape(-1, MEAN_TICKS).mean(axis=1)
    return float(np.ptp(means))


def _peaks(trace: PressTrace) -> tuple[float, float]:
    """Return the largest force at the wrist, and its largest slew over a frame."""
    forces = trace.hold_down_n[::FRAME_TICKS]
    return float(forces.max()), _largest(np.diff(forces)) / (FRAME_TICKS * TICK_NS * 1e-9)
