"""The report of the study of prediction with an ECG."""

from collections.abc import Iterable
from typing import TYPE_CHECKING

from telepulse.document import STYLES, Chapter, Plot, Report, Table, percent
from telepulse.reports.studies.announce_detector import MATCH_S, MATCHED_FROM_S
from telepulse.reports.studies.announce_oracle import HORIZONS_MS as ORACLE_HORIZONS_MS
from telepulse.reports.studies.announce_oracle import OracleErrors
from telepulse.reports.studies.announce_pulses import JUMP, NOISE_MV, TRANSIT_S
from telepulse.reports.studies.announce_study import (
    FAULT_FROM_S,
    FOUND_OUT_S,
    AnnounceEffort,
    AnnounceScores,
    FoundOut,
    PulseErrors,
)
from telepulse.reports.studies.prediction_pulses import SCORED_FROM_S
from telepulse.reports.studies.prediction_study import HORIZONS_MS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

HORIZON_COLUMNS = tuple(f"{horizon_ms} ms" for horizon_ms in HORIZONS_MS)
# NRMSE at 100 ms to reach with a jitter of 5 ms; and a relative rise that counts as none.
BARS = {"variability": 0.12, "ectopic": 0.16, "fibrillation": 0.15}
BAR_JITTER_S, EQUAL = 0.005, 0.005
# Share of the time in which a wrong ECG may be used.
UNUSED = 0.05
LEAST_SCORE = 0.99
COST_RATIO = 1.3


def report_announce(scores: AnnounceScores, effort: AnnounceEffort) -> Report:
    """Return the report on scores that took this effort."""
    chapters = [_errors_chapter(scores, effort), _faults_chapter(scores), _cost_chapter(scores)]
    if scores.detector:
        chapters.insert(1, _detector_chapter(scores))
    return Report("Prediction of beats that an ECG announces", chapters)


def _errors_chapter(scores: AnnounceScores, effort: AnnounceEffort) -> Chapter:
    words = (
        f"Each pulse is that of `telepulse study prediction` over {effort.seconds:g} s, in frames"
        f" of 5 ms, scored after {SCORED_FROM_S:g} s. The R wave of a synthetic ECG precedes each"
        f" onset by {1e3 * TRANSIT_S:g} ms and a random deviation; the ECG has noise of"
        f" {NOISE_MV:g} mV RMS. Without a shape cue, only the rhythm or the ECG predicts the next"
        " beat. Variability: 4 % of the interval. Ectopic: one beat in twenty is early and weak."
        " Fibrillation: independent intervals of 0.7 s with a deviation of a fifth.",
        "Each cell: NRMSE without / with the ECG, on average of the seeds"
        f" {', '.join(map(str, effort.seeds))}; with a shape cue, of the first seed.",
    )
    tables = [
        _errors_table(f"Transit time varies by {1e3 * jitter_s:g} ms", errors)
        if jitter_s
        else _errors_table("Recordings", errors)
        for jitter_s, errors in scores.errors.items()
    ]
    if scores.limit:
        tables.append(_errors_table("Limit: transit time that does not vary", scores.limit))

    if scores.oracle:
        tables.append(_oracle_table(scores.oracle))

    def draw(figure: "Figure") -> None:
        axes = figure.add_subplot()
        for style, each in zip(STYLES, scores.errors[BAR_JITTER_S], strict=False):
            (line,) = axes.plot(HORIZONS_MS, each.without, style, alpha=0.4)
            axes.plot(HORIZONS_MS, each.announced, style, color=line.get_color(), label=each.name)
        axes.set(yscale="log", xlabel="horizon (ms)", ylabel="NRMSE")
        figure.legend(loc="outside lower center", ncols=3, fontsize="small")

    caption = "NRMSE against the horizon: without the ECG (pale) and with it."
    at_100_ms = HORIZONS_MS.index(100)
    errors = [
        f"{each.name} {each.without[at_100_ms]:.3f} → {each.announced[at_100_ms]:.3f}"
        for each in scores.errors[BAR_JITTER_S]
    ]
    finding = f"NRMSE 100 ms ahead, without → with the ECG: {'; '.join(errors)}."
    plots = (Plot("announced-error", caption, draw),)
    return Chapter("Errors", words, tables, plots, (finding,))


def _errors_table(title: str, errors: Iterable[PulseErrors]) -> Table:
    rows = []
    for each in errors:
        pairs = zip(each.without, each.announced, strict=True)
        rows.append(
            (
                each.name,
                *(f"{without:.3f} / {announced:.3f}" for without, announced in pairs),
                f"{each.transit_ms:.0f} ± {each.deviation_ms:.0f}",
                percent(each.used, ".0f"),
            )
        )
    return Table(title, ("pulse", *HORIZON_COLUMNS, "transit time, ms", "used"), rows)


def _oracle_table(oracle: tuple[OracleErrors, ...]) -> Table:
    rows = [
        (name, *(f"{mean:.3f}, {most:.3f}" for mean, most in pairs))
        for name, pairs in _oracle_limits(oracle).items()
    ]
    jitter = f"{1e3 * BAR_JITTER_S:g} ms"
    title = f"Limit: an oracle that has the generator, transit time varying by {jitter}"
    columns = ("pulse", *(f"{each} ms" for each in ORACLE_HORIZONS_MS))
    return Table(f"{title}; mean and greatest of the seeds", columns, rows)


def _oracle_limits(oracle: tuple[OracleErrors, ...]) -> dict[str, list[tuple[float, float]]]:
    """Return mean and greatest error of the seeds at each of the oracle's horizons, by pulse."""
    runs: dict[str, list[tuple[float, ...]]] = {}
    for each in oracle:
        runs.setdefault(each.name, []).append(each.errors)
    return {
        name: [(sum(at) / len(at), max(at)) for at in zip(*errors, strict=True)]
        for name, errors in runs.items()
    }


def _detector_chapter(scores: AnnounceScores) -> Chapter:
    words = (
        "R waves found frame by frame, matched with the annotations of cardiologists within"
        f" {1e3 * MATCH_S:g} ms, as ANSI/AAMI EC57 prescribes, after {MATCHED_FROM_S:g} s. Latency:"
        " median time from an R wave to the end of the samples by which it was found.",
    )
    rows = [
        (
            each.lead,
            f"{each.beats}",
            f"{each.sensitivity:.4f}",
            f"{each.precision:.4f}",
            f"{each.deviation_ms:.1f}",
            f"{each.latency_ms:.0f}",
        )
        for each in scores.detector
    ]
    columns = ("lead", "beats", "sensitivity", "precision", "deviation, ms", "latency, ms")
    return Chapter("R waves", words, (Table("Annotated records", columns, rows),))


def _faults_chapter(scores: AnnounceScores) -> Chapter:
    words = (
        f"From {FAULT_FROM_S:g} s on, the ECG is wrong. The time until the predictor no longer used"
        f" it; the share of the time from {FOUND_OUT_S:g} s later on in which it was used; and the"
        " NRMSE 100 ms ahead without / with the wrong ECG, before and after that instant. An ECG"
        " that has jumped by a constant is used again, with another transit time. The last column"
        " is the greatest rise of the NRMSE by it, of all horizons.",
    )
    rows = [
        (
            each.pulse,
            each.fault,
            f"{each.seconds:.2f}",
            percent(each.used, ".1f"),
            *(f"{without:.3f} / {wrong:.3f}" for without, wrong in (each.early, each.late)),
            percent(each.rise, "+.1f"),
        )
        for each in scores.faults
    ]
    window = f"{FOUND_OUT_S:g} s"
    columns = (
        "pulse",
        "the ECG",
        "found out after, s",
        f"used from {window} on",
        f"NRMSE in {window}",
        "NRMSE after",
        "rise after",
    )
    slowest_s = max(each.seconds for each in scores.faults)
    finding = f"A wrong ECG is no longer used after at most {slowest_s:.2f} s."
    tables = (Table("Faults of the ECG", columns, rows),)
    return Chapter("A wrong ECG", words, tables, findings=(finding,))


def _cost_chapter(scores: AnnounceScores) -> Chapter:
    words = (
        "Processor time of all the work on a frame with the ECG, its R waves included, over that"
        f" without: {scores.cost_ratio:.2f}.",
        *(f"{what}: {'met' if reached else 'missed'}." for what, reached in bars(scores)),
    )
    found = bars(scores)
    missed = [what for what, reached in found if not reached]
    findings = [f"{len(found) - len(missed)} of {len(found)} criteria are met."]
    if missed:
        findings.append(f"Missed: {'; '.join(missed)}.")
    return Chapter("Cost and criteria", words, findings=findings)


def bars(scores: AnnounceScores) -> list[tuple[str, bool]]:
    """Return what was to be reached, and whether it was."""
    errors, at_100_ms = scores.errors, HORIZONS_MS.index(100)
    found, limits = [], _oracle_limits(scores.oracle)
    for each in errors[BAR_JITTER_S]:
        bar = BARS[each.name.partition(",")[0]]
        kinds = {"on average": each.announced, "at worst": each.worst}
        for kind, values in kinds.items() if len(each.runs) > 1 else [("", each.announced)]:
            where = f"{each.name}, {kind} of {len(each.runs)}" if kind else each.name
            what = f"{where}: {values[at_100_ms]:.3f} at 100 ms, at most {bar:.2f}"
            if limit := limits.get(each.name):
                mean, greatest = limit[ORACLE_HORIZONS_MS.index(100)]
                what = f"{what}, an oracle's {greatest if kind == 'at worst' else mean:.3f}"
            found.append((what, values[at_100_ms] <= bar))
    most = percent(EQUAL, "+.1f")
    for jitter_s, sets in errors.items():
        if jitter_s == BAR_JITTER_S:
            continue
        for each in sets:
            rise = each.greatest_rise
            where = f"{each.name}, jitter {1e3 * jitter_s:g} ms" if jitter_s else each.name
            what = f"{where}: at its worst horizon {percent(rise, '+.1f')}, at most {most}"
            found.append((what, rise <= EQUAL))
    slowest_s = max(each.seconds for each in scores.faults)
    what = f"found out within {slowest_s:.2f} s, at most {FOUND_OUT_S:g}"
    found += [(what, slowest_s <= FOUND_OUT_S), *map(_fault_bar, scores.faults)]
    for lead in scores.detector:
        least = min(lead.sensitivity, lead.precision)
        found.append((f"{lead.lead}: {least:.4f}, at least {LEAST_SCORE:g}", least >= LEAST_SCORE))
    ratio = scores.cost_ratio
    found.append((f"cost {ratio:.2f}, about {COST_RATIO:g} at most", ratio <= COST_RATIO))
    return found


def _fault_bar(each: FoundOut) -> tuple[str, bool]:
    """Return what a fault was to come to: no use, or after a jump, use without harm."""
    where = f"{each.pulse}, ECG {each.fault}"
    if each.fault != JUMP:
        what = f"{where}: then used for {percent(each.used, '.1f')} of the time, at most"
        return f"{what} {percent(UNUSED, '.0f')}", each.used <= UNUSED
    without, announced = each.late
    what = f"{where}: then {announced:.3f} at 100 ms, at most {without:.3f}"
    return what, announced <= without * (1 + EQUAL)
