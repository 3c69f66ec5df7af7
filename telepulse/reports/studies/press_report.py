"""The report of the study of the press, with its chapters on steps and wrists."""

from typing import TYPE_CHECKING

import numpy as np

from display_node.press.sweep import CLOSED
from telepulse.document import Chapter, Plot, Report, Table, percent
from telepulse.reports.studies.press_criteria import (
    follows,
    height_text,
    missed_criteria,
    ms_text,
    renders,
    verdict,
)
from telepulse.reports.studies.press_runs import (
    FOLLOW_ERROR,
    FOLLOWED_S,
    HEIGHT_ERROR,
    LEARNT_S,
)
from telepulse.reports.studies.press_scores import PressEffort, PressScores
from telepulse.reports.studies.press_stability_report import (
    limits_chapter,
    stability_chapter,
    tcp_chapter,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def report_press(scores: PressScores, effort: PressEffort) -> Report:
    """Return the report on scores that took this effort."""
    return Report(
        "The press: from the finger to the wrist and back",
        (
            _wrist_chapter(scores),
            _steps_chapter(scores, effort),
            _wrists_chapter(scores),
            _stiffness_chapter(scores),
            stability_chapter(scores),
            limits_chapter(scores),
            tcp_chapter(scores),
            Chapter("What is missed", (), findings=(missed_criteria(scores),)),
        ),
    )


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
                "round trip": ms_text(trip_s),
                "hold-down": percent(max(max(run.late) for run in runs)),
                "height": height_text(runs),
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
            axes.plot(step.time_s, step.hold_down_n, label=f"hold-down, {ms_text(trip_s)}")
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
        f"Up to a round trip of {ms_text(max(scores.follow))}, the hold-down follows the press"
        f" within {percent(max(max(run.late) for run in every))} (criterion: at most"
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
            "round trip": ms_text(trip_s),
            "hold-down": percent(max(run.late)),
            "height": height_text([run]),
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
        f" {height_text(list(runs))} off (criterion: at most {percent(HEIGHT_ERROR, '.0f')},"
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
            **{ms_text(trip_s): percent(scores.stiff[trip_s, tissue, finger]) for trip_s in trips},
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
