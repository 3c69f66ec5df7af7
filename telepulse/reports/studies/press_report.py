"""The report of the study of the press: the wrist's curve, steps, stability, limits, TCP."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from display_node.press.finger_press import PressLimits
from display_node.press.loop_gain import MOST_GAIN as BOUNDED_GAIN
from display_node.press.sweep import CLOSED
from sensing_node.press.probe import ProbeLimits
from telepulse.reports.document import STYLES, Chapter, Plot, Report, Table
from telepulse.reports.notation import percent
from telepulse.reports.studies.press_scores import (
    BAND_HZ,
    EASED_S,
    FOLLOW_ERROR,
    FOLLOWED_S,
    HEIGHT_ERROR,
    LEARNT_S,
    LONG_FRAMES,
    LONG_FROM_S,
    MOST_GAIN,
    REST_N,
    SCENE_VARIANT,
    WINDOW_S,
    WINDOWS,
    FollowScore,
    PressEffort,
    PressScores,
    TcpVariant,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MET, MISSED = "met", "missed"


def report_press(scores: PressScores, effort: PressEffort) -> Report:
    """Return the report on scores that took this effort."""
    return Report(
        "The press: from the finger to the wrist and back",
        (
            _wrist_chapter(scores),
            _steps_chapter(scores, effort),
            _wrists_chapter(scores),
            _stiffness_chapter(scores),
            _stability_chapter(scores),
            _limits_chapter(scores),
            _tcp_chapter(scores),
            Chapter("What is missed", (), findings=(_missed(scores),)),
        ),
    )


def _missed(scores: PressScores) -> str:
    """Return the finding that names every criterion that is missed, or that none is."""
    own = [run for runs in scores.follow.values() for run in runs]
    far = _scene_runs(scores)
    limits, hand = ProbeLimits(), PressLimits()
    peaks, eased_s = _peaks(scores), max(scores.eased_s.values())
    gain = _largest_gain(scores)
    beyond = [run.beyond for run in scores.wrists.values() if not renders(run)]
    stiff = [key for key, error in scores.stiff.items() if error > FOLLOW_ERROR]
    checks = {
        "the hold-down on the study's own wrist": all(map(follows, own)),
        "the height on the study's own wrist": all(map(renders, own)),
        "the hold-down on other wrists": all(map(follows, scores.wrists.values())),
        f"the height on other wrists, in {len(beyond)} of {len(scores.wrists)} runs, in up to"
        f" {percent(max(beyond, default=0.0))} of the beats of one": not beyond,
        f"the hold-down with {len(stiff)} of {len(scores.stiff)} pairs of a stiffness and a round"
        " trip": not stiff,
        "the decay after a step": all(swing.decays for swing in scores.swing.values()),
        f"the loop's gain, {gain:.4f}": gain < MOST_GAIN,
        "the probe's limits": all(
            force_n <= limits.force_n and slew <= limits.slew_n_per_s
            for force_n, slew in peaks.values()
        ),
        "the finger's limits": _within_hand(scores, hand),
        "the time to ease off": eased_s <= EASED_S,
        "the hold-down over TCP": all(map(follows, far.values())),
        "the height over TCP": all(map(renders, far.values())),
    }
    missed = [name for name, met in checks.items() if not met]
    return f"Missed: {'; '.join(missed)}." if missed else "All criteria are met."


def _within_hand(scores: PressScores, limits: PressLimits) -> bool:
    force_n, slew = scores.finger
    # The slew of two set-points is measured over a time that is rounded to ticks.
    return force_n <= limits.force_n and slew <= 1.001 * limits.slew_n_per_s


def _largest_gain(scores: PressScores) -> float:
    runs = [*(run for runs in scores.follow.values() for run in runs), *scores.wrists.values()]
    return max(*(run.gain for run in runs), *(max(pair) for pair in scores.gains.values()))


def _scene_runs(scores: PressScores) -> dict[float, FollowScore]:
    """Return the runs over TCP of the scenes' own variants: `press`, and from 1 s `press_far`."""
    return {
        trip_s: run
        for (trip_s, variant), run in scores.tcp.items()
        if variant == (LONG_FRAMES if trip_s >= LONG_FROM_S else SCENE_VARIANT)
    }


def verdict(met: bool) -> str:
    """Return a criterion's verdict as a word."""
    return MET if met else MISSED


def follows(score: FollowScore) -> bool:
    """Return whether every step was followed within the criterion."""
    return max(score.late) <= FOLLOW_ERROR


def renders(score: FollowScore) -> bool:
    """Return whether every beat had the height that the press would give, within the criterion."""
    return max(map(abs, score.heights)) <= HEIGHT_ERROR


def _wrist_chapter(scores: PressScores) -> Chapter:
    force_n, truth_n, learnt_n = scores.heights

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        axes.plot(force_n, 1e3 * truth_n, label="wrist")
        axes.plot(force_n, 1e3 * learnt_n, "--", label="learnt at the finger")
        axes.set(xlabel="hold-down (N)", ylabel="height of the pulse (mN)")
        axes.legend()

    best = int(truth_n.argmax())
    slope = float(np.abs(np.gradient(truth_n, force_n)).max())
    words = (
        "The synthetic wrist: arterial pressure of 120/80 mmHg through a tube law (C. F. Babbs,"
        " “Oscillometric measurement of systolic and diastolic blood pressures validated in a"
        " physiologic mathematical model”, BioMedical Engineering OnLine 11 (2012) 56)"
        f" under a probe of 1 cm². The pulse is highest, {1e3 * truth_n[best]:.0f} mN, at"
        f" {force_n[best]:.2f} N, which is the mean arterial pressure. Its slope is at most"
        f" {slope:.2f} N/N. The learnt curve is that of the finger at the end of a run, which has"
        " pressed with 0.6 to 1.5 N; outside of these, it is an extrapolation."
    )
    plot = Plot("height", "Height of the pulse against hold-down.", draw)
    return Chapter("The wrist", (words,), plots=(plot,))


def _steps_chapter(scores: PressScores, effort: PressEffort) -> Chapter:
    rows = []
    for trip_s, runs in scores.follow.items():
        account = runs[0].account
        rows.append(
            {
                "round trip": _ms(trip_s),
                "hold-down": percent(max(max(run.late) for run in runs)),
                "height": _heights(runs),
                "loop gain": f"{max(run.gain for run in runs):.4f}",
                "sent": f"{account.sent}",
                "applied": f"{account.applied}",
                "superseded": f"{account.superseded}",
                "lost": f"{account.lost}",
                "criteria": f"{verdict(all(map(follows, runs)))},"
                f" {verdict(all(map(renders, runs)))}",
            }
        )

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        for number, (trip_s, step) in enumerate(scores.steps.items()):
            if not number:
                axes.plot(step.time_s, step.press_n, ":", label="press")
            axes.plot(step.time_s, step.hold_down_n, label=f"hold-down, {_ms(trip_s)}")
        axes.set(xlabel="time after the step (s)", ylabel="force (N)")
        axes.legend()

    words = (
        f"A finger steps between forces of 0.6 and 1.5 N every 4 s, for {effort.seconds:g} s, over"
        " links with 10 % of jitter and 1 % of loss of every message; the steps after the first"
        f" {LEARNT_S:g} s count, of {len(effort.seeds)} runs with their own seeds. In each, steps"
        " meet another part of the beat."
        f" Hold-down: largest error against the press from {FOLLOWED_S:g} s and a round trip after"
        f" a step on (criterion: at most {percent(FOLLOW_ERROR, '.0f')}). Height: of the felt"
        " pulse, over each beat, against"
        " that which the present press would give; it is judged from the step on, also while the"
        f" hold-down has not followed yet (criterion: at most {percent(HEIGHT_ERROR, '.0f')})."
        " Loop gain: as the finger"
        " measures it."
    )
    note = "Sent = applied + superseded + lost, of the first run; those under way count as lost."
    table = Table.of("Steps by round trip", rows, note)
    plot = Plot("steps", "A step of the press, and the hold-down over several round trips.", draw)
    every = [run for runs in scores.follow.values() for run in runs]
    finding = (
        f"Up to a round trip of {_ms(max(scores.follow))}, the hold-down follows the press within"
        f" {percent(max(max(run.late) for run in every))} (criterion: at most"
        f" {percent(FOLLOW_ERROR, '.0f')},"
        f" {verdict(all(map(follows, every)))}), and the felt pulse has the height of the present"
        f" press within {percent(max(max(map(abs, run.heights)) for run in every))} (criterion: at"
        f" most {percent(HEIGHT_ERROR, '.0f')}, {verdict(all(map(renders, every)))})."
    )
    return Chapter("Steps", (words,), (table,), (plot,), (finding,))


def _wrists_chapter(scores: PressScores) -> Chapter:
    rows = [
        {
            "wrist": name,
            "round trip": _ms(trip_s),
            "hold-down": percent(max(run.late)),
            "height": _heights([run]),
            "beyond": percent(run.beyond),
            "loop gain": f"{run.gain:.4f}",
            "criteria": f"{verdict(follows(run))}, {verdict(renders(run))}",
        }
        for (name, trip_s), run in scores.wrists.items()
    ]
    if not rows:
        return Chapter("Other wrists", ())
    words = (
        "Wrists of 70 to 130 mmHg mean arterial pressure, named by it, have a pulse pressure of 40"
        " mmHg, 4 % of variability, respiration of 20 % and heart rates of 60 to 90 a minute; the"
        " regular ones are named by systole and diastole. All are modelled. In the first"
        f" {LEARNT_S:g} s the finger presses with each of ten levels in turn, as a sweep does; then"
        " it steps between them. The levels lie between the forces at which the wrist's pulse has"
        f" {CLOSED:g} of its largest height. Height: against that which the wrist gives to the"
        " present press at that instant of its respiration. Beyond: share of the beats whose height"
        f" is more than {percent(HEIGHT_ERROR, '.0f')} off.",
        "A closed artery shows no diastole, which respiration moves; it follows from the wave of"
        " the beats before. Near it, 1 % of the press is 10 % of the height. So the steps to and"
        " from the deepest levels have the largest errors, until the hold-down has followed.",
    )
    runs = scores.wrists.values()
    mean = sum(run.beyond for run in runs) / len(runs)
    finding = (
        f"On {len({name for name, _ in scores.wrists})} other modelled wrists, the hold-down is"
        f" within {percent(max(max(run.late) for run in runs))} of the press (criterion: at most"
        f" {percent(FOLLOW_ERROR, '.0f')}, {verdict(all(map(follows, runs)))}); the felt height is"
        f" {_heights(list(runs))} off (criterion: at most {percent(HEIGHT_ERROR, '.0f')},"
        f" {verdict(all(map(renders, runs)))}), and beyond the criterion in"
        f" {percent(mean)} of the beats. {sum(map(renders, runs))} of {len(scores.wrists)} runs"
        " meet it."
    )
    table = Table.of("Steps on other wrists", rows)
    return Chapter("Other wrists", words, (table,), findings=(finding,))


def _stiffness_chapter(scores: PressScores) -> Chapter:
    pairs = sorted({(tissue, finger) for _, tissue, finger in scores.stiff})
    trips = sorted({trip_s for trip_s, *_ in scores.stiff})
    rows = [
        {
            "tissue": f"{tissue:g} times",
            "finger": f"{finger:g} times",
            **{_ms(trip_s): percent(scores.stiff[trip_s, tissue, finger]) for trip_s in trips},
            "criterion": verdict(
                max(scores.stiff[trip_s, tissue, finger] for trip_s in trips) <= FOLLOW_ERROR
            ),
        }
        for tissue, finger in pairs
    ]
    words = (
        "Largest error of the hold-down from 0.3 s and a round trip after a step on, with other"
        " stiffnesses than the models'. A stiff finger on soft tissue still follows the tip then,"
        " and the press moves. Its change until the set-point arrives is predicted from the tip's"
        " course and the learnt stiffness of the hand.",
    )
    meets = [pair for pair in pairs if all(scores.stiff[t, *pair] <= FOLLOW_ERROR for t in trips)]
    finding = (
        f"With {len(meets)} of {len(pairs)} pairs of tissue and finger the hold-down meets its"
        f" criterion at every round trip; the largest error is"
        f" {percent(max(scores.stiff.values(), default=0.0))}."
    )
    table = Table.of("Error of the hold-down by stiffness and round trip", rows)
    return Chapter("Stiffness", words, (table,), findings=(finding,))


def _stability_chapter(scores: PressScores) -> Chapter:
    trips = sorted({trip_s for trip_s, *_ in scores.swing})
    rows = []
    for trip_s in trips:
        swings = [swing for (at_s, *_), swing in scores.swing.items() if at_s == trip_s]
        largest = [max(1e3 * swing.rms_n[number] for swing in swings) for number in range(WINDOWS)]
        cells = {
            f"{number * WINDOW_S:g} to {(number + 1) * WINDOW_S:g} s": f"{rms_mn:.2f}"
            for number, rms_mn in enumerate(largest)
        }
        decays = verdict(all(swing.decays for swing in swings))
        rows.append({"round trip": _ms(trip_s), **cells, "criterion": decays})

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        middles_s = [WINDOW_S * (number + 0.5) for number in range(WINDOWS)]
        for style, trip_s in zip(STYLES, trips, strict=False):
            swings = [swing for (at_s, *_), swing in scores.swing.items() if at_s == trip_s]
            rms_mn = [max(1e3 * swing.rms_n[i] for swing in swings) for i in range(WINDOWS)]
            axes.plot(middles_s, rms_mn, style, label=_ms(trip_s))
        axes.set(yscale="log", xlabel="time after the step (s)", ylabel="RMS of the set-point (mN)")
        axes.legend()

    stiffness = sorted({tissue for _, tissue, _ in scores.swing})
    gains = [
        {
            "pulse's share in the reading": f"{share:g}",
            "opened loop": f"{measured:.4f}",
            "as the finger measures it": f"{bound:.4f}",
            "criterion": verdict(max(measured, bound) < MOST_GAIN),
        }
        for share, (measured, bound) in scores.gains.items()
    ]
    words = (
        "After a step the hand means a constant force. Energy of the set-point between"
        f" {BAND_HZ[0]:g} and {BAND_HZ[1]:g} Hz, as RMS in mN over windows of {WINDOW_S:g} s,"
        " from 0.5 s and a round trip after the step on: the largest over finger and tissue of each"
        f" {', '.join(f'{each:g}' for each in stiffness)} times the model's stiffness. Criterion:"
        " no"
        f" window has more than the one before it, or than {1e3 * REST_N:g} mN. What is in the"
        " first window is the hand, which follows a tip that yields.",
        "The gain is measured with the loop opened at the wrist, which is pressed by steps of its"
        " own while the hand means a constant force: the largest change of the set-point over that"
        f" of the hold-down. It is compared with the bound {MOST_GAIN:g} of the small-gain"
        " argument; below 1 no delay can make the loop swing. The set-point follows the press by a"
        f" smaller share while the gain would be above {BOUNDED_GAIN:g}.",
    )
    tables = (
        Table.of("What swings on after a step: RMS of the set-point (mN)", rows),
        Table.of("Gain of the loop through the network", gains),
    )
    plot = Plot("swing", "RMS of the set-point after a step, the worst finger and tissue.", draw)
    largest_gain = _largest_gain(scores)
    finding = (
        "After a step nothing swings on, for any round trip, finger or tissue:"
        f" {verdict(all(swing.decays for swing in scores.swing.values()))}. The loop's gain is at"
        f" most {largest_gain:.4f} (criterion: below {MOST_GAIN:g},"
        f" {verdict(largest_gain < MOST_GAIN)})."
    )
    return Chapter("Stability", words, tables, (plot,), (finding,))


def _peaks(scores: PressScores) -> dict[str, tuple[float, float]]:
    """Return the greatest force and slew at the wrist, by case."""
    every = [run for runs in scores.follow.values() for run in runs]
    every += [*scores.tcp.values(), *scores.wrists.values()]
    peaks = [(run.greatest_n, run.slew_n_per_s) for run in every]
    peaks += [(swing.greatest_n, swing.slew_n_per_s) for swing in scores.swing.values()]
    return {"all runs of this study": (max(a for a, _ in peaks), max(b for _, b in peaks))} | {
        f"hostile display, tissue {tissue:g} times as stiff": peak
        for tissue, peak in scores.hostile.items()
    }


def _limits_chapter(scores: PressScores) -> Chapter:
    limits = ProbeLimits()
    cases, hand = _peaks(scores), PressLimits()
    rows = [
        {
            "case": name,
            "force (N)": f"{force_n:.2f}",
            "slew (N/s)": f"{slew:.1f}",
            "criterion": verdict(force_n <= limits.force_n and slew <= limits.slew_n_per_s),
        }
        for name, (force_n, slew) in cases.items()
    ]
    finger_n, finger_slew = scores.finger
    rows.append(
        {
            "case": "set-points of the finger, hostile wrist",
            "force (N)": f"{finger_n:.2f}",
            "slew (N/s)": f"{finger_slew:.1f}",
            "criterion": verdict(_within_hand(scores, hand)),
        }
    )
    eased = {
        tissue: max(time_s for (at, _), time_s in scores.eased_s.items() if at == tissue)
        for tissue, _ in scores.eased_s
    }
    times = [
        {
            "tissue": f"{tissue:g} times",
            "eased off": f"{time_s:.2f} s",
            "criterion": verdict(time_s <= EASED_S),
        }
        for tissue, time_s in eased.items()
    ]
    words = (
        f"Limits at the wrist: {limits.force_n:g} N and {limits.slew_n_per_s:g} N/s; of the"
        f" finger's set-points: {hand.force_n:g} N and {hand.slew_n_per_s:g} N/s. The hostile wrist"
        " reports random forces up to 9·10⁵ N. The hostile"
        " display sends 1600 set-points a second of 0 to 10⁶ N, repeated, out of order, and of two"
        " runs.",
        "Time from the last set-point that arrives before a cut, pressed with 2.5 N, until the"
        f" force is within 0.05 N of the resting {limits.resting_n:g} N: the longest over the round"
        " trips.",
    )
    tables = Table.of("Largest force and slew", rows), Table.of("Eased off after a cut", times)
    force_n, slew = (max(values) for values in zip(*cases.values(), strict=True))
    within = force_n <= limits.force_n and slew <= limits.slew_n_per_s
    finding = (
        f"No display makes the probe press with more than {force_n:.2f} N or {slew:.1f} N/s"
        f" (limits: {limits.force_n:g} N and {limits.slew_n_per_s:g} N/s, {verdict(within)});"
        " after a cut it"
        f" eases off within {max(eased.values()):.2f} s (criterion: at most {EASED_S:g} s,"
        f" {verdict(max(eased.values()) <= EASED_S)})."
    )
    return Chapter("Limits and cuts", words, tables, findings=(finding,))


def _tcp_chapter(scores: PressScores) -> Chapter:
    rows = [
        {
            "round trip": _ms(trip_s),
            "connections": f"{variant.connections}"
            + (", each twice" if variant.copies > 1 else ""),
            "frames": f"{variant.batch} ms over {variant.paths}",
            "steps followed": f"{_followed(run)} of {len(run.late)}",
            "applied": f"{run.account.applied} of {run.account.sent}",
            "height": _heights([run]),
            "scene": _scene_of(trip_s, variant),
            "criteria": f"{verdict(follows(run))}, {verdict(renders(run))}",
        }
        for (trip_s, variant), run in scores.tcp.items()
    ]
    words = (
        "The same over TCP with 1 % of its packets lost, where everything after a lost packet waits"
        " 1.25 round trips for its repetition. From a round trip of 240 ms on this is longer than"
        f" the {ProbeLimits().stale_after_ns * 1e-6:.0f} ms after which the probe eases off, and 50"
        " set-points a second lose one every 2 s. Set-points take turns over several connections,"
        " of which some may stall; where each is sent twice, over two, both stall as often as one."
        " The frames stall as well: from 1 s on, 200 a second over one connection leave the finger"
        " blind, and it sends nothing; fewer frames, over several connections, do not."
    )
    tables = (Table.of("Steps over TCP", rows),) if rows else ()
    if not (runs := _scene_runs(scores)):
        return Chapter("Over TCP", (words,), tables)
    finding = (
        "Over TCP with 1 % of the packets lost, the hold-down follows the press within"
        f" {percent(max(max(run.late) for run in runs.values()))} (criterion: at most"
        f" {percent(FOLLOW_ERROR, '.0f')}, {verdict(all(map(follows, runs.values())))}), and the"
        f" height is {_heights(list(runs.values()))} off (criterion: at most"
        f" {percent(HEIGHT_ERROR, '.0f')}, {verdict(all(map(renders, runs.values())))}): with the"
        f" scene press, and from a round trip of {_ms(LONG_FROM_S)} on with press_far."
    )
    return Chapter("Over TCP", (words,), tables, findings=(finding,))


def _scene_of(trip_s: float, variant: TcpVariant) -> str:
    if variant == LONG_FRAMES:
        return "press_far"
    return "press" if variant == SCENE_VARIANT else "none"


def _heights(runs: Sequence[FollowScore]) -> str:
    least, most = min(min(run.heights) for run in runs), max(max(run.heights) for run in runs)
    return f"{percent(least, '+.1f')} to {percent(most, '+.1f')}"


def _followed(score: FollowScore) -> int:
    return sum(late <= FOLLOW_ERROR for late in score.late)


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.0f} ms"
