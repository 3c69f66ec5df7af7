"""Steps, stability and limits of the press, from the finger to the wrist, over round trips.

In virtual time, on modelled wrists, over links with 10 % of jitter and 1 % of loss. A finger steps
between forces every 4 s; after 30 s, in which it learns, steps are scored.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Final, NamedTuple

from benchmarks.benchmark import Benchmark
from display_node.press.finger_press import PressLimits
from sensing_node.press.probe import ProbeLimits
from telepulse.simulation.link_scene import LinkScene
from tests.support.press_loop import BATCH, ArterialPulse, PressSetting, link_of
from tests.support.press_runs import (
    FOLLOW_ERROR,
    REST_N,
    WINDOW_S,
    WINDOWS,
    FollowScore,
    SwingScore,
    be_hostile,
    be_hostile_to_the_finger,
    ease_off,
    follow,
    hold_down_error,
    open_gain,
    swing,
)

ROUND_TRIPS_S: Final = (0.0, 0.1, 0.3, 1.0, 2.0)
STIFFNESSES: Final = (0.3, 1.0, 3.0)
SECONDS, SEEDS = 70.0, 2
# A step is five beats long. So that not all runs step in the same part of a beat, each plays this
# much later than the one before.
LATER_NS: Final = 700_000_000
# Other wrists: arteries of 70 to 130 mmHg with an irregular heart and respiration, each with rates
# of its own, and regular ones with other pulse pressures, over two round trips.
MEAN_SHARE, PULSE_MMHG = 0.27, 40.0
RATES_HZ: Final = {70.0: 0.2, 85.0: 0.23, 100.0: 0.27, 115.0: 0.3, 130.0: 0.33}
PULSES: Final = {
    f"{mean_mmhg:g} mmHg, respiration": ArterialPulse(
        mean_mmhg + (1 - MEAN_SHARE) * PULSE_MMHG,
        mean_mmhg - MEAN_SHARE * PULSE_MMHG,
        1.0 + (mean_mmhg - 70.0) / 120,
        0.04,
        0.2,
        rate_hz,
    )
    for mean_mmhg, rate_hz in RATES_HZ.items()
}
REGULAR_PULSES: Final = {
    f"{high_mmhg:g}/{low_mmhg:g} mmHg, regular": ArterialPulse(high_mmhg, low_mmhg)
    for high_mmhg, low_mmhg in ((90.0, 60.0), (120.0, 60.0), (140.0, 90.0), (160.0, 100.0))
}
REGULAR_TRIPS_S: Final = (0.1, 1.0)
STIFF_TRIPS_S: Final = (0.1, 0.3, 1.0)


class TcpVariant(NamedTuple):
    """Connections of the set-points, copies of each, samples in a frame, connections of those."""

    connections: int
    copies: int = 1
    batch: int = BATCH
    paths: int = 1


# What is compared over TCP. The criteria are for the variants of the scenes: `press`, and from 1 s
# on `press_far`, with long frames.
VARIANTS: Final = (TcpVariant(1), TcpVariant(2, 2), TcpVariant(4), TcpVariant(16))
LONG_FRAMES: Final = TcpVariant(16, 1, 50, 8)
LONG_FROM_S: Final = 1.0


def main(benchmark: Benchmark) -> None:
    """Print steps, wrists, stiffnesses, stability, limits and TCP, and judge them."""
    trips_s = (0.1,) if benchmark.quick else ROUND_TRIPS_S
    stiffnesses = (3.0,) if benchmark.quick else STIFFNESSES
    runs = [*show_steps(benchmark, trips_s), *show_wrists(benchmark, trips_s)]
    settings = [
        PressSetting(link_of(trip_s), tissue, finger, pulse_share=finger)
        for trip_s in trips_s
        for tissue in stiffnesses
        for finger in stiffnesses
    ]
    show_stiffness(benchmark, settings)
    swings = show_swings(benchmark, settings)
    show_gains(benchmark, stiffnesses, runs)
    over_tcp = show_tcp(benchmark, trips_s)
    peaks = [(run.greatest_n, run.slew_n_per_s) for run in (*runs, *over_tcp)]
    peaks += [(run.greatest_n, run.slew_n_per_s) for run in swings]
    show_limits(benchmark, stiffnesses, peaks)
    show_cuts(benchmark, stiffnesses, trips_s)


def show_steps(benchmark: Benchmark, trips_s: Sequence[float]) -> list[FollowScore]:
    """Print the steps on the scenes' own wrist by round trip; return all runs."""
    seeds = range(1, 2 if benchmark.quick else 1 + (benchmark.seeds or SEEDS))
    cases = [
        PressSetting(link_of(trip_s), seed=seed, later_ns=(seed - 1) * LATER_NS)
        for trip_s in trips_s
        for seed in seeds
    ]
    runs = _follow(benchmark, cases)
    by_trip: dict[float, list[FollowScore]] = {}
    for case, run in zip(cases, runs, strict=True):
        by_trip.setdefault(_round_trip_s(case), []).append(run)
    rows = []
    for trip_s, each in by_trip.items():
        account = each[0].account
        counts = account.sent, account.applied, account.superseded, account.lost
        gain = max(run.gain for run in each)
        rows.append((_ms(trip_s), _late(each), _heights(each), f"{gain:.4f}", *map(str, counts)))
    benchmark.table(
        f"Steps on the scene's wrist, {len(seeds)} runs each: largest error of the hold-down from"
        " 0.3 s and a round trip after a step on, of the pulse's height over each beat, and gain",
        ("round trip", "hold-down", "height", "gain", "sent", "applied", "superseded", "lost"),
        rows,
        "The counts are those of the first run; set-points under way count as lost.",
    )
    _judge_runs(benchmark, "own wrist", runs)
    return runs


def show_wrists(benchmark: Benchmark, trips_s: Sequence[float]) -> list[FollowScore]:
    """Print the steps on other wrists, each over its round trips; return all runs."""
    pulses = PULSES | REGULAR_PULSES
    names = [
        (name, trip_s)
        for name in (list(pulses)[-1:] if benchmark.quick else pulses)
        for trip_s in trips_s
        if name not in REGULAR_PULSES or trip_s in REGULAR_TRIPS_S
    ]
    cases = [
        PressSetting(
            link_of(trip_s), seed=number + 1, later_ns=number % 2 * LATER_NS, pulse=pulses[name]
        )
        for number, (name, trip_s) in enumerate(names)
    ]
    runs = _follow(benchmark, cases)
    benchmark.table(
        "Steps on other wrists; beyond: share of the beats whose height misses the criterion",
        ("wrist", "round trip", "hold-down", "height", "beyond", "gain"),
        [
            (
                name,
                _ms(trip_s),
                _late([run]),
                _heights([run]),
                _percent(run.beyond),
                f"{run.gain:.4f}",
            )
            for (name, trip_s), run in zip(names, runs, strict=True)
        ],
    )
    _judge_runs(benchmark, "other wrists", runs)
    return runs


def show_stiffness(benchmark: Benchmark, settings: Sequence[PressSetting]) -> None:
    """Print the error of the hold-down by stiffness of tissue and finger."""
    cases = [case for case in settings if _round_trip_s(case) in STIFF_TRIPS_S]
    errors = benchmark.run(hold_down_error, cases)
    benchmark.table(
        "Largest error of the hold-down by stiffness, in times the models'",
        ("tissue", "finger", "round trip", "hold-down"),
        [
            (f"{case.tissue:g}", f"{case.finger:g}", _ms(_round_trip_s(case)), _percent(error))
            for case, error in zip(cases, errors, strict=True)
        ],
    )
    benchmark.judge("hold-down at other stiffnesses", max(errors))


def show_swings(benchmark: Benchmark, settings: Sequence[PressSetting]) -> list[SwingScore]:
    """Print what swings on in the set-point after a step; return all runs."""
    swings = benchmark.run(swing, settings)
    rows = []
    for trip_s in dict.fromkeys(map(_round_trip_s, settings)):
        pairs = zip(settings, swings, strict=True)
        mine = [each for case, each in pairs if _round_trip_s(case) == trip_s]
        largest = (max(1e3 * each.rms_n[number] for each in mine) for number in range(WINDOWS))
        rows.append((_ms(trip_s), *(f"{rms_mn:.2f}" for rms_mn in largest)))
    columns = [
        f"{number * WINDOW_S:g} to {(number + 1) * WINDOW_S:g} s" for number in range(WINDOWS)
    ]
    benchmark.table(
        "What swings on after a step: RMS of the set-point, mN, largest of all stiffnesses",
        ("round trip", *columns),
        rows,
    )
    rises = [
        later - max(earlier, REST_N)
        for each in swings
        for earlier, later in zip(each.rms_n, each.rms_n[1:], strict=False)
    ]
    benchmark.judge("rise of what swings on after a step", max(rises))
    return swings


def show_gains(
    benchmark: Benchmark, stiffnesses: Sequence[float], runs: Sequence[FollowScore]
) -> None:
    """Print the gain of the opened loop, beside that which the finger measures."""
    shares = [PressSetting(link_of(0.1), pulse_share=each) for each in stiffnesses]
    gains = benchmark.run(open_gain, shares)
    benchmark.table(
        "Gain of the loop through the network",
        ("pulse's share in the reading", "opened loop", "as the finger measures it"),
        [
            (f"{case.pulse_share:g}", f"{measured:.4f}", f"{bound:.4f}")
            for case, (measured, bound) in zip(shares, gains, strict=True)
        ],
    )
    benchmark.judge("gain of the loop", max(*(run.gain for run in runs), *map(max, gains)))


def show_tcp(benchmark: Benchmark, trips_s: Sequence[float]) -> list[FollowScore]:
    """Print the steps over TCP that loses 1 % of its packets; return all runs."""
    variants = VARIANTS[-1:] if benchmark.quick else VARIANTS
    cases = [
        (trip_s, variant)
        for trip_s in trips_s
        if trip_s
        for variant in (*variants, *([LONG_FRAMES] if trip_s >= LONG_FROM_S else []))
    ]
    settings = [PressSetting(link_of(trip_s, "tcp"), **it._asdict()) for trip_s, it in cases]
    runs = dict(zip(cases, _follow(benchmark, settings), strict=True))
    benchmark.table(
        "Steps over TCP with 1 % of its packets lost",
        ("round trip", "connections", "frames", "steps followed", "applied", "height"),
        [
            (
                _ms(trip_s),
                f"{variant.connections}{', each twice' if variant.copies > 1 else ''}",
                f"{variant.batch} ms over {variant.paths}",
                f"{sum(late <= FOLLOW_ERROR for late in run.late)} of {len(run.late)}",
                f"{run.account.applied} of {run.account.sent}",
                _heights([run]),
            )
            for (trip_s, variant), run in runs.items()
        ],
    )
    of_scenes = [
        run
        for (trip_s, variant), run in runs.items()
        if variant == (LONG_FRAMES if trip_s >= LONG_FROM_S else VARIANTS[-1])
    ]
    _judge_runs(benchmark, "over TCP", of_scenes)
    return list(runs.values())


def show_limits(
    benchmark: Benchmark, stiffnesses: Sequence[float], peaks: Iterable[tuple[float, float]]
) -> None:
    """Print the largest forces and slews at the wrist, and of a finger's set-points."""
    hostile = benchmark.run(be_hostile, stiffnesses)
    cases = {
        "all runs above": tuple(map(max, zip(*peaks, strict=True))),
        **{
            f"hostile display, tissue {tissue:g} times as stiff": peak
            for tissue, peak in zip(stiffnesses, hostile, strict=True)
        },
    }
    finger_n, finger_slew = be_hostile_to_the_finger()
    limits, hand = ProbeLimits(), PressLimits()
    benchmark.table(
        f"Largest force and slew; limits at the wrist {limits.force_limit_n:g} N and"
        f" {limits.slew_limit_n_per_s:g} N/s, of the finger {hand.force_n:g} N and"
        f" {hand.slew_n_per_s:g} N/s",
        ("case", "force, N", "slew, N/s"),
        [
            *((name, f"{force_n:.2f}", f"{slew:.1f}") for name, (force_n, slew) in cases.items()),
            ("set-points of the finger, hostile wrist", f"{finger_n:.2f}", f"{finger_slew:.1f}"),
        ],
    )
    force_n, slew = (max(values) for values in zip(*cases.values(), strict=True))
    benchmark.judge("force at the wrist over its limit", force_n / limits.force_limit_n)
    benchmark.judge("slew at the wrist over its limit", slew / limits.slew_limit_n_per_s)
    benchmark.judge("force of the finger over its limit", finger_n / hand.force_n)
    benchmark.judge("slew of the finger over its limit", finger_slew / hand.slew_n_per_s)


def show_cuts(benchmark: Benchmark, stiffnesses: Sequence[float], trips_s: Sequence[float]) -> None:
    """Print the time from the last set-point before a cut until the wrist is free."""
    cases = [PressSetting(_cut(trip_s), each) for each in stiffnesses for trip_s in trips_s]
    eased_s = dict(zip(cases, benchmark.run(ease_off, cases), strict=True))
    longest_s: Mapping[float, float] = {
        tissue: max(time_s for case, time_s in eased_s.items() if case.tissue == tissue)
        for tissue in stiffnesses
    }
    benchmark.table(
        "Eased off after a cut, longest of the round trips",
        ("tissue", "s"),
        [(f"{tissue:g} times", f"{time_s:.2f}") for tissue, time_s in longest_s.items()],
    )
    benchmark.judge("time to ease off after a cut", max(longest_s.values()))


def _follow(benchmark: Benchmark, cases: Sequence[PressSetting]) -> list[FollowScore]:
    return benchmark.run(partial(follow, seconds=40.0 if benchmark.quick else SECONDS), cases)


def _judge_runs(benchmark: Benchmark, where: str, runs: Sequence[FollowScore]) -> None:
    benchmark.judge(f"hold-down, {where}", max(max(run.late) for run in runs))
    benchmark.judge(f"height, {where}", max(max(map(abs, run.heights)) for run in runs))


def _late(runs: Sequence[FollowScore]) -> str:
    return _percent(max(max(run.late) for run in runs))


def _heights(runs: Sequence[FollowScore]) -> str:
    """Return the least and the largest error of the height."""
    least, most = min(min(run.heights) for run in runs), max(max(run.heights) for run in runs)
    return f"{100 * least:+.1f} to {100 * most:+.1f} %"


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms"


def _cut(round_trip_s: float) -> LinkScene:
    cut = {"cut": {"from": "4 s", "for": "10 s"}}
    link = link_of(round_trip_s)
    return link.model_copy(update={"cut": LinkScene.model_validate(cut).cut})


def _round_trip_s(setting: PressSetting) -> float:
    return round(2e-9 * setting.link.delay_ns, 6)
