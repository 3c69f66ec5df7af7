"""Scores of the press in virtual time: the bars of the loop from the finger to the wrist and back.

A finger steps between forces every 4 s. Scored are: the hold-down against the press, the height of
the felt pulse against that which the present press would give, what swings on in the set-point
after a step, the gain of the opened loop, forces and slews, and the time to ease off.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.press.sweep import CLOSED
from protocol.press_figures import SetPointCounts
from protocol.wire.messages import SetPoint
from sensing_node.press.probe import ProbeLimits
from sensing_node.press.set_points import SetPointServer
from sensing_node.sources.wrist import Wrist
from telepulse.reports.studies.sweep import sweep
from telepulse.simulation.link_scene import LinkScene
from telepulse.simulation.press_loop import (
    AHEAD_NS,
    BATCH,
    OWN_PULSE,
    PRESS,
    SESSION,
    TICK_NS,
    ArterialPulse,
    Meant,
    PressLoop,
    PressSetting,
    PressTrace,
    link_of,
    wrist_scene,
)

ROUND_TRIPS_S: Final = (0.0, 0.1, 0.3, 1.0, 2.0)
STIFFNESSES: Final = (0.3, 1.0, 3.0)
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
# A step is five beats long. So that not all runs step in the same part of a beat, each plays this
# much later than the one before.
LATER_NS: Final = 700_000_000
Floats = NDArray[np.float64]
# Other wrists: arteries of 70 to 130 mmHg with an irregular heart and respiration, each with rates
# of its own, and regular ones with other pulse pressures.
MEAN_SHARE, PULSE_MMHG = 0.27, 40.0
PULSES: Final = {
    f"{mean_mmhg:g} mmHg, respiration": ArterialPulse(
        mean_mmhg + (1 - MEAN_SHARE) * PULSE_MMHG,
        mean_mmhg - MEAN_SHARE * PULSE_MMHG,
        1.0 + (mean_mmhg - 70.0) / 120,
        0.04,
        0.2,
        rate_hz,
    )
    for mean_mmhg, rate_hz in (
        (70.0, 0.2),
        (85.0, 0.23),
        (100.0, 0.27),
        (115.0, 0.3),
        (130.0, 0.33),
    )
}
REGULAR_PULSES: Final = {
    f"{high_mmhg:g}/{low_mmhg:g} mmHg, regular": ArterialPulse(high_mmhg, low_mmhg)
    for high_mmhg, low_mmhg in ((90.0, 60.0), (120.0, 60.0), (140.0, 90.0), (160.0, 100.0))
}
# A practitioner presses a new wrist at each level first; each for this time.
VISIT_S: Final = 3.0
# Round trips of the regular wrists, and of the runs with other stiffnesses of tissue and finger.
REGULAR_TRIPS_S: Final = (0.1, 1.0)
STIFF_TRIPS_S: Final = (0.1, 0.3, 1.0)
# Runs with other stiffnesses of tissue and finger: their length.
STIFF_S: Final = 48.0


class TcpVariant(NamedTuple):
    """Connections of the set-points, copies of each, samples in a frame, connections of those."""

    connections: int
    copies: int = 1
    batch: int = BATCH
    paths: int = 1


# What is compared over TCP: the bars are for the scene's own variant, from 1 s on with long frames.
VARIANTS: Final = (TcpVariant(1), TcpVariant(2, 2), TcpVariant(4), TcpVariant(16))
SCENE_VARIANT: Final = VARIANTS[-1]
LONG_FRAMES: Final = TcpVariant(16, 1, 50, 8)
LONG_FROM_S: Final = 1.0


@dataclass(frozen=True, slots=True)
class PressEffort:
    """Round trips, seeds, and the length of a run; of it, the first 30 s are for learning.

    variants: what is compared over TCP. pulses: of the other wrists.
    """

    round_trips_s: tuple[float, ...] = ROUND_TRIPS_S
    stiffnesses: tuple[float, ...] = STIFFNESSES
    seeds: tuple[int, ...] = (1, 2)
    seconds: float = 70.0
    variants: tuple[TcpVariant, ...] = VARIANTS
    pulses: Mapping[str, ArterialPulse] = field(default_factory=lambda: PULSES | REGULAR_PULSES)


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


class PressStep(NamedTuple):
    """Press and hold-down around one step, at times relative to it."""

    time_s: Floats
    press_n: Floats
    hold_down_n: Floats


class HeightPoints(NamedTuple):
    """The pulse's height against hold-down: forces, the wrist's, and the learnt one."""

    force_n: Floats
    truth_n: Floats
    learnt_n: Floats


@dataclass(frozen=True, slots=True)
class PressScores:
    """All scores.

    follow: by round trip, of all seeds. tcp: by round trip and variant. swing: by
    round trip, tissue and finger. gains: measured gain of the opened loop, by the pulse's share.
    eased_s: by tissue and round trip. hostile: greatest force and slew, by tissue. wrists: by pulse
    and round trip. stiff: largest error of the hold-down, by round trip, tissue and finger. finger:
    greatest force and slew of the set-points with a hostile wrist.
    """

    follow: dict[float, list[FollowScore]]
    tcp: dict[tuple[float, TcpVariant], FollowScore]
    swing: dict[tuple[float, float, float], SwingScore]
    gains: dict[float, tuple[float, float]]
    eased_s: dict[tuple[float, float], float]
    hostile: dict[float, tuple[float, float]]
    steps: dict[float, PressStep]
    heights: HeightPoints
    wrists: dict[tuple[str, float], FollowScore]
    stiff: dict[tuple[float, float, float], float]
    finger: tuple[float, float]


def steps(time_s: float, levels_n: Sequence[float] = LEVELS_N) -> float:
    """Return the force that the hand means at a time: a step every `STEP_S`."""
    number = int(time_s / STEP_S)
    after = levels_n[number % len(levels_n)]
    before = levels_n[(number - 1) % len(levels_n)] if number else 0.0
    part = min(1.0, (time_s - number * STEP_S) / RISE_S)
    return before + (after - before) * (0.5 - 0.5 * math.cos(math.pi * part))


def follow(setting: PressSetting, seconds: float) -> tuple[FollowScore, PressStep, HeightPoints]:
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
    score = FollowScore(tuple(late), tuple(heights), gain, *_peaks(trace), account)
    begin = _ticks(math.ceil(LEARNT_S / STEP_S) * STEP_S)
    shown = slice(begin - _ticks(0.5), begin + _ticks(3.5))
    response = PressStep(
        trace.time_s[shown] - trace.time_s[begin], trace.press_n[shown], trace.hold_down_n[shown]
    )
    forces = np.arange(0.4, 1.81, 0.02)
    truth = np.array([loop.wrist.artery.height_n(force_n) for force_n in forces])
    learnt = np.array([loop.press.curve.height(force_n) for force_n in forces])
    return score, response, HeightPoints(forces, truth, learnt)


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
    score, *_ = follow(setting, STIFF_S)
    return max(score.late)


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
    loop = PressLoop(_with_open_loop(setting, forces), lambda time_s: 1.0)
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


def score_press(effort: PressEffort, scheduler: str | None = None) -> PressScores:
    """Run all cases, on all cores or on a cluster."""
    trips = effort.round_trips_s
    plain = [
        PressSetting(link_of(trip), seed=seed, later_ns=number * LATER_NS)
        for trip in trips
        for number, seed in enumerate(effort.seeds)
    ]
    variants = {
        trip: (*effort.variants, LONG_FRAMES) if trip >= LONG_FROM_S else effort.variants
        for trip in trips
        if trip
    }
    tcp_cases = [(trip, variant) for trip, each in variants.items() for variant in each]
    tcp = [PressSetting(link_of(trip, "tcp"), **variant._asdict()) for trip, variant in tcp_cases]
    wrists = [
        (name, trip)
        for name in effort.pulses
        for trip in trips
        if name not in REGULAR_PULSES or trip in REGULAR_TRIPS_S
    ]
    others = [
        PressSetting(
            link_of(trip),
            seed=number + 1,
            later_ns=number % 2 * LATER_NS,
            pulse=effort.pulses[name],
        )
        for number, (name, trip) in enumerate(wrists)
    ]
    cases = [*plain, *tcp, *others]
    followed = sweep(partial(follow, seconds=effort.seconds), cases, scheduler)
    stiff = [case for case in swings_of(effort) if _round_trip_s(case) in STIFF_TRIPS_S]
    errors = sweep(hold_down_error, stiff, scheduler)
    swings = swings_of(effort)
    swung = sweep(swing, swings, scheduler)
    shares = [PressSetting(link_of(0.1), pulse_share=each) for each in effort.stiffnesses]
    gains = sweep(open_gain, shares, scheduler)
    cuts = [PressSetting(_cut(trip), each) for each in effort.stiffnesses for trip in trips]
    eased = sweep(ease_off, cuts, scheduler)
    hostile = sweep(be_hostile, effort.stiffnesses, scheduler)
    each_seed = len(effort.seeds)
    of_tcp = followed[len(plain) : len(plain) + len(tcp)]
    of_others = [score for score, *_ in followed[len(plain) + len(tcp) :]]
    return PressScores(
        {
            trip: [score for score, *_ in followed[each_seed * at : each_seed * (at + 1)]]
            for at, trip in enumerate(trips)
        },
        {case: score for case, (score, *_) in zip(tcp_cases, of_tcp, strict=True)},
        {
            (_round_trip_s(case), case.tissue, case.finger): score
            for case, score in zip(swings, swung, strict=True)
        },
        dict(zip(effort.stiffnesses, gains, strict=True)),
        {
            (case.tissue, _round_trip_s(case)): eased_s
            for case, eased_s in zip(cuts, eased, strict=True)
        },
        dict(zip(effort.stiffnesses, hostile, strict=True)),
        {trip: followed[each_seed * at][1] for at, trip in enumerate(trips)},
        followed[0][2],
        dict(zip(wrists, of_others, strict=True)),
        {
            (_round_trip_s(case), case.tissue, case.finger): error
            for case, error in zip(stiff, errors, strict=True)
        },
        be_hostile_to_the_finger(),
    )


def swings_of(effort: PressEffort) -> list[PressSetting]:
    """Return the settings of all stiffnesses of tissue and finger, at all round trips."""
    return [
        PressSetting(link_of(trip), tissue, finger, pulse_share=finger)
        for trip in effort.round_trips_s
        for tissue in effort.stiffnesses
        for finger in effort.stiffnesses
    ]


def _cut(round_trip_s: float) -> LinkScene:
    cut = {"cut": {"from": "4 s", "for": "10 s"}}
    link = link_of(round_trip_s)
    return link.model_copy(update={"cut": LinkScene.model_validate(cut).cut})


def _round_trip_s(setting: PressSetting) -> float:
    return round(2e-9 * setting.link.delay_ns, 6)


def _with_open_loop(setting: PressSetting, forces: Meant) -> PressSetting:
    return PressSetting(
        setting.link, setting.tissue, setting.finger, setting.pulse_share, open_loop=forces
    )


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
