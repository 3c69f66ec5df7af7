"""Scores of the press in virtual time: the bars of the loop from the finger to the wrist and back.

They are those of all runs, over round trips, wrists, stiffnesses and connections.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Final, NamedTuple

from telepulse.parallel import sweep
from telepulse.reports.studies.press_runs import (
    FollowScore,
    HeightPoints,
    PressStep,
    SwingScore,
    be_hostile,
    be_hostile_to_the_finger,
    ease_off,
    follow,
    hold_down_error,
    open_gain,
    swing,
)
from telepulse.simulation.link_scene import LinkScene
from telepulse.simulation.press_loop import BATCH, ArterialPulse, PressSetting, link_of

ROUND_TRIPS_S: Final = (0.0, 0.1, 0.3, 1.0, 2.0)
STIFFNESSES: Final = (0.3, 1.0, 3.0)
# A step is five beats long. So that not all runs step in the same part of a beat, each plays this
# much later than the one before.
LATER_NS: Final = 700_000_000
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
# Round trips of the regular wrists, and of the runs with other stiffnesses of tissue and finger.
REGULAR_TRIPS_S: Final = (0.1, 1.0)
STIFF_TRIPS_S: Final = (0.1, 0.3, 1.0)


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
