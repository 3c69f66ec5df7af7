"""The report of `telepulse experiment`: tables and plots of one session, or of several."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from protocol.config.quantities import count_text
from telepulse.document import Chapter, Report, Table, provenance_table
from telepulse.experiment import plots
from telepulse.experiment.log import (
    SessionLog,
    SessionResults,
    TrialOutcome,
    gather,
    share_close,
    share_correct,
)
from telepulse.experiment.psychometrics import (
    LEVEL,
    PAPER,
    Proportion,
    Threshold,
    d_prime,
    fit_threshold,
    hits_needed,
    mean_of,
    percent,
    power,
)

NONE = "–"
DIRECT = "no link (catch)"


def build_report(logs: Sequence[SessionLog], with_spoilt: bool = False) -> Report:
    """Report one subject or several; with_spoilt: include spoilt trials.

    Raises LogError.
    """
    results = gather(logs, with_spoilt)
    answers = _abx_chapter(results) if results.kind == "abx" else _rating_chapter(results)
    labels, others = _labels(results), list[Table]()
    if results.spoilt:
        spoilt = [
            (o.subject, str(o.answered.index + 1), o.trial.condition or DIRECT, o.spoilt)
            for o in results.spoilt
        ]
        others.append(Table("Spoilt trials", ("subject", "trial", "condition", "why"), spoilt))
    # The result first, then what qualifies it.
    answers = replace(
        answers,
        paragraphs=(_answered(results), *_versions(results)),
        findings=(*answers.findings, *labels),
        tables=(*answers.tables, *others),
    )
    made = [
        provenance_table(log.path.stem, log.header.provenance)
        for log in logs
        if log.header.provenance
    ]
    provenance = [Chapter("Provenance of the sessions", tables=made, folded=True)] if made else []
    chapters = (answers, _course_chapter(results), _errors_chapter(results), _paper_chapter())
    return Report(f"Experiment: {results.title}", (*chapters, *provenance))


def _labels(results: SessionResults) -> list[str]:
    """Return at most three remarks on the answers."""
    labels = []
    if results.thresholds:
        shown = ", ".join(f"{100 * threshold:g} %" for threshold in results.thresholds)
        labels.append(
            f"Simulated: the answers are those of simulated observers (threshold {shown});"
            " no person felt anything."
        )
    elif results.who != "a person":
        labels.append("Nobody felt anything: the scene's models ran, without a drive.")
    if results.spoilt:
        trials = count_text(len(results.spoilt), "answered trial")
        verb = "is" if len(results.spoilt) == 1 else "are"
        fate = "included" if results.pooled else "left out of all figures but their own"
        labels.append(
            f"{trials} {verb} spoilt by missed ticks, or by a stale stream without a link, and"
            f" {verb} {fate}."
        )
    stale = [
        f"{name}: {count}"
        for name, found in results.by_condition()
        if (count := sum(o.stale for o in found))
    ]
    if stale:
        labels.append(
            "In some trials the stream was stale over the link. They are included, since this is"
            f" an effect of the condition: {', '.join(stale)}."
        )
    return labels


def _versions(results: SessionResults) -> list[str]:
    if len(results.versions) < 2:
        return []
    return [f"The logs are of several versions: {', '.join(results.versions)}."]


def threshold_of(outcomes: Sequence[TrialOutcome]) -> Threshold | None:
    """Return the maximum likelihood threshold of ABX answers, as a share of the pulse."""
    felt = [o for o in outcomes if not any(map(math.isnan, o.errors))]
    return fit_threshold([(o.errors, o.answered.answer == "A") for o in felt])


def _abx_chapter(results: SessionResults) -> Chapter:
    tables = [_right_table(results), _threshold_table(results)]
    if len(results.subjects) > 1:
        tables.insert(1, _subject_table(results))
    if catch := results.of(None):
        called_a = _cells(Proportion(sum(o.answered.answer == "A" for o in catch), len(catch)))
        tables.append(
            Table(
                "Catch trials: A, B and X without a link",
                ("answer", "trials", "share", "95 %"),
                [("X called A", *called_a[:3])],
                "There is no right answer; far from a half, the subject prefers a key.",
            )
        )
    found = share_correct(results.tested)
    who = _who(results)
    result = (
        f"{who[0].upper()}{who[1:]} identified X in {found.hits} of {found.of} trials,"
        f" {percent(found.share)} (95 % Clopper–Pearson confidence interval"
        f" {_between(found)}). By guessing, as many or more are right with a probability of"
        f" {_p(found.p_value)} (one-sided exact binomial test)."
    )
    drawn = (plots.shares(results), plots.psychometric(results, threshold_of(results.outcomes)))
    findings, value, bounds = [result], *_threshold_cells(threshold_of(results.outcomes))
    if bounds != NONE:
        findings.append(
            "Threshold, the force error at which d' is 1, over the pulse from peak to peak:"
            f" {bounds if value == NONE else f'{value}, 95 % confidence interval {bounds}'}."
        )
    return Chapter("Right answers", (), tables, drawn, findings)


def _answered(results: SessionResults) -> str:
    count = len(results.outcomes)
    if not results.pooled:
        count += len(results.spoilt)
    return f"{count} of {results.trials} trials are answered, by {_who(results)}."


def _who(results: SessionResults) -> str:
    kind, subjects = "simulated observer" if results.thresholds else "subject", results.subjects
    return f"one {kind}" if len(subjects) == 1 else f"{len(subjects)} {kind}s"


def _right_table(results: SessionResults) -> Table:
    rows = []
    for name, outcomes in (*results.by_condition(), ("all of them", results.tested)):
        direct, link = (
            _mean(o.force_mn(on, "aligned_n") for o in outcomes) for on in (False, True)
        )
        found = share_correct(outcomes)
        at, low, high = (d_prime(share) for share in (found.share, *found.interval))
        value, least, most = ("∞" if math.isinf(d) else f"{d:.1f}" for d in (at, low, high))
        d = f"{value} ({least} to {most})"
        rows.append((name, *_cells(found), d, direct, link))
    return Table(
        "X identified",
        ("condition", "right", "share", "95 %", "p", "d' (95 %)", "direct (mN)", "link (mN)"),
        rows,
        "95 %: exact confidence interval (Clopper–Pearson). p: probability of as many right answers"
        " or more by guessing, not corrected for the number of conditions. d' of the differencing"
        " strategy; ∞ where all answers are right. mN: aligned force RMSE. Trials of one subject"
        " are no independent sample of people.",
    )


def _cells(found: Proportion) -> tuple[str, str, str, str]:
    hits = f"{found.hits} of {found.of}"
    return hits, percent(found.share), _between(found), _p(found.p_value)


def _between(found: Proportion) -> str:
    low, high = found.interval
    return f"{100 * low:.1f} to {100 * high:.1f} %"


def _p(value: float) -> str:
    return "< 0.001" if value < 1e-3 else f"{value:.3f}"


def _subject_table(results: SessionResults) -> Table:
    by_subject = {
        subject: [o for o in results.tested if o.subject == subject] for subject in results.subjects
    }
    shares = {subject: share_correct(found) for subject, found in by_subject.items() if found}
    passed = sum(found.p_value <= LEVEL for found in shares.values())
    return Table(
        "Each subject",
        ("subject", "right", "share", "95 %", "p"),
        [(subject, *_cells(found)) for subject, found in shares.items()],
        f"{passed} of {len(shares)} are right more often than by guessing (p ≤ 5 %); of subjects"
        " who guess, one in twenty would be.",
    )


def _threshold_table(results: SessionResults) -> Table:
    names = list(results.subjects)
    groups = [(name, [o for o in results.outcomes if o.subject == name]) for name in names]
    if len(names) > 1:
        groups.append(("all", list(results.outcomes)))
    return Table(
        "Threshold: force error at which d' is 1, in % of the pulse from peak to peak",
        ("subject", "threshold", "95 %"),
        [(name, *_threshold_cells(threshold_of(found))) for name, found in groups],
        "Maximum likelihood for a differencing observer of the aligned force error; 95 % confidence"
        " interval by profile likelihood. –: the answers set no bound.",
    )


def _threshold_cells(found: Threshold | None) -> tuple[str, str]:
    if found is None:
        return NONE, NONE
    if found.low == 0:
        return NONE, f"below {100 * found.high:.2g} %"
    if math.isinf(found.high):
        return NONE, f"above {100 * found.low:.2g} %"
    return f"{100 * found.value:.2g} %", f"{100 * found.low:.2g} to {100 * found.high:.2g} %"


def _rating_chapter(results: SessionResults) -> Chapter:
    groups = list(results.by_condition())
    if results.of(None):
        groups.append((DIRECT, results.of(None)))
    rows = []
    for name, outcomes in groups:
        mean, close = mean_of([o.rating for o in outcomes]), _cells(share_close(outcomes))
        interval = f"{mean.value:.2f} ({mean.low:.2f} to {mean.high:.2f})"
        link_mn = _mean(o.force_mn(True, "aligned_n") for o in outcomes)
        rows.append((name, str(len(outcomes)), interval, *close[:3], link_mn))
    table = Table(
        "How close X was to the direct touch, 5 (the same) to 1",
        ("condition", "trials", "mean (95 %)", "close", "share", "95 %", "link (mN)"),
        rows,
        "Close: rated 4 or 5, with its exact interval. Of the mean: percentile bootstrap, too"
        " narrow for few trials. mN: aligned force RMSE. X without a link is the hidden reference.",
    )
    found = share_close(results.tested)
    result = (
        f"Over the link, {found.hits} of {found.of} trials, {percent(found.share)}, were rated"
        " close"
        f" to the direct touch (95 % Clopper–Pearson confidence interval {_between(found)}), by"
        f" {_who(results)}."
    )
    return Chapter("Ratings", (), (table,), (plots.ratings(groups),), (result,))


def _course_chapter(results: SessionResults) -> Chapter:
    times = [t for o in results.outcomes if (t := o.answered.response_s) is not None]
    plays = [len(o.answered.played) for o in results.outcomes]
    words = f"Intervals felt for an answer: {np.mean(plays):.1f} on average, {max(plays)} at most."
    if times:
        words += (
            f" Time to the answer: median {np.median(times):.1f} s, longest {max(times):.1f} s."
        )
    return Chapter("In the course of the session", (words,), plots=(plots.course(results),))


def _errors_chapter(results: SessionResults) -> Chapter:
    rows = []
    for name, outcomes in [*results.by_condition(), (DIRECT, results.of(None))]:
        for on_link, what in ((True, "link"), (False, "direct")):
            played = [p for o in outcomes for p in o.answered.played if p.on_link is on_link]
            if not played:
                continue
            milli = [
                _mean(1e3 * value for p in played if (value := getattr(p, field)) is not None)
                for field in ("aligned_n", "in_phase_n", "roughness_felt_n", "roughness_sensed_n")
            ]
            misses = sum(p.deadline_misses for p in played)
            rows.append((f"{name}: {what}", str(len(played)), *milli, str(misses)))
    table = Table(
        "What was played, mean of its intervals in mN",
        ("intervals", "count", "aligned", "in phase", "over 25 Hz", "sensed", "misses"),
        rows,
        "Aligned: RMSE against the pulse of the instant played; in phase: against that very moment."
        " Over 25 Hz: RMS felt, and what was sensed of it. Misses: ticks that did not begin in"
        " time, of all intervals.",
    )
    return Chapter("Objective errors", (), (table,), (plots.errors(results),))


def _mean(values: Iterable[float]) -> str:
    found = [value for value in values if not math.isnan(value)]
    return f"{np.mean(found):.2f}" if found else NONE


def _paper_chapter() -> Chapter:
    columns = ("study", "close", "share", "95 %", "p")
    row = ("paper, section 5.4", *_cells(PAPER))
    table = Table("The paper's figure", columns, [row])
    return Chapter(
        "The paper's six subjects",
        (
            "The paper reports that 66 % of six subjects felt it close to a direct touch. That is"
            f" four of six: the exact 95 % confidence interval of the share is {_between(PAPER)},"
            " and six tosses of a coin give four or more with a probability of"
            f" {_p(PAPER.p_value)}. At least {hits_needed(6)} of six answers must agree before p"
            " is at most"
            " 5 %; with a true share of two in three that has a probability of"
            f" {percent(power(6, PAPER.share))}. Six subjects can show that something is felt by"
            " nearly everybody; they cannot distinguish two thirds from a half, nor from all.",
        ),
        (table,),
    )
