"""Verdict on a display's run, in at most six lines, for the person at it.

Every other figure of the run is in the rows of `protocol.summary.rows`, which --details prints.
The status line of a display that runs has no error of the felt force: the verdict is the first text
in the terminal that has.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from protocol.cli_options import fault_status, sum_up
from protocol.faults import Note, texts_by_part
from protocol.provenance import Provenance
from protocol.refusals import CAUSE_MEANINGS
from protocol.summary.fields import Limits, Summary
from protocol.tactile import JND

MOST_LINES = 6
# Exit status of a run that is not valid and latched no fault.
NOT_VALID_STATUS = 4
# Above this share of missed ticks, the force felt was not the one that the loop computes.
MOST_MISSED = 0.5
# From these shares on, something is worth a line.
LATE_TICKS, NOTICED, LIMITED = 0.01, 0.05, 0.01
LONG_GAP_MS = 50.0
LEAST_PERCENT = 0.1
# Messages refused in every run: while joining, or because a copy had arrived already.
USUAL = ("before_welcome", "before_clock", "duplicate", "overlap", "session", "too_old")
DOCTOR = "display-node --doctor names what helps"


class Verdict(NamedTuple):
    """Lines for a person; valid: whether the run shows what the link and the scene can do."""

    lines: tuple[str, ...]
    valid: bool


def verdict(summary: Summary) -> Verdict:
    """Return what happened in a display's run, first of all whether the run is valid.

    The lines say how long and how faithfully the pulse was felt, its delay, what was lost, and what
    is wrong and what to do about it, or that nothing is. Those without a figure are left out.
    """
    ruined = _ruined(summary)
    told = [*_felt(summary), *_error(summary), *_delay(summary), *_lost(summary)]
    wrong = list(_wrong(summary))
    first = [] if ruined is None else [f"This run is not valid: {ruined}."]
    if not wrong and ruined is None:
        wrong = ["Nothing is wrong."]
    free = MOST_LINES - len(first) - len(told)
    if len(wrong) > free:
        wrong = [*wrong[: free - 1], f"{wrong[free - 1]} (And {len(wrong) - free} more.)"]
    return Verdict((*first, *told, *wrong), ruined is None)


def conclude(
    program: str,
    summary: Summary,
    title: str,
    console: Console,
    json: Path | None,
    provenance: Provenance,
    details: bool,
) -> int:
    """Print the verdict on a run, latched faults on stderr, and with `details` all figures.

    Returns the exit status: 0, `FAULT_STATUS` or `NOT_VALID_STATUS`. `sum_up` has the other
    arguments.
    """
    lines, valid = verdict(summary)
    sum_up(program, summary, title, console, json, provenance, lines, details)
    return fault_status(program, summary) or (0 if valid else NOT_VALID_STATUS)


def _ruined(summary: Summary) -> str | None:
    """Return why a run is not valid; None for a valid one."""
    of_run = summary.availability
    if summary.faults:
        return f"it stopped at the fault {str(summary.faults[0])!r}"
    if not of_run.felt:
        return f"no pulse was felt; {_why_nothing(summary)}"
    if (of_run.missed or 0.0) > MOST_MISSED:
        return (
            f"{_percent(of_run.missed)} of the ticks were missed: this computer was too busy, or"
            f" too slow; {DOCTOR}"
        )
    return None


def _why_nothing(summary: Summary) -> str:
    """Return why a display felt no pulse at all."""
    refused = _unusual(summary.rejected)
    if reasons := summary.waiting_for:
        return "; ".join(map(str, reasons))
    if refused and summary.clock.offset_ms is None:
        return _most(refused)
    if summary.clock.offset_ms is None:
        return "the sensing node did not answer: check its address, and that it runs"
    if not summary.samples.sent:
        return "the sensing node sent no samples: check its source"
    return "the stream ended, or the display was stopped, before the pulse was at full strength"


def _in_time(summary: Summary, sentence: str) -> str:
    """Return a sentence on the felt pulse, which a fault has ended."""
    if summary.faults:
        return f"Before the fault {sentence}"
    return f"{sentence[0].upper()}{sentence[1:]}"


def _felt(summary: Summary) -> Iterator[str]:
    """Yield how long the pulse was felt, and its rate."""
    of_run = summary.availability
    if not of_run.felt or of_run.seconds is None:
        return
    figures = summary.of_each_contactor().values()
    rates = [rate for each in figures if (rate := each.beats.rate_per_min) is not None]
    beats = f", at {rates[0]:.0f} beats a minute" if rates else ""
    around = sum(share or 0.0 for share in (of_run.waiting, of_run.starting, of_run.ended))
    felt_s, around_s = of_run.felt * of_run.seconds, around * of_run.seconds
    yield _in_time(
        summary,
        f"the pulse was felt for {felt_s:.1f} of {of_run.seconds:.1f} s{beats}; start and end took"
        f" {around_s:.1f} s.",
    )


def _error(summary: Summary) -> Iterator[str]:
    """Yield how far the felt force was off; of several contactors that of the worst one."""
    worst = summary.worst_contactor()
    if worst is None:
        return
    name, rmse_n, figures = worst
    of = f" at {name}, the worst contactor," if name else ""
    # One digit, where the figures have more: a finger notices none of them.
    text = f"the force{of} was off by {1e3 * rmse_n:.1f} mN (force RMSE, aligned)"
    if height_n := figures.beats.height_at_finger_n:
        share = _percent(rmse_n / height_n)
        text += f", {share} of the pulse's height; a finger notices {100 * JND:.0f} % or more"
        if figures.within_jnd is not None:
            text += f", for {_percent(1 - figures.within_jnd)} of the time"
    yield _in_time(summary, f"{text}.")


def _delay(summary: Summary) -> Iterator[str]:
    """Yield the delay that the finger felt, and that of the network."""
    felt_ms, network = summary.playout_delay_ms.mean, summary.one_way_delay_ms
    if felt_ms is None or network.p50 is None:
        return
    ahead = ", thanks to prediction" if felt_ms < network.p50 else ""
    off_n = max(
        (
            figures.force_rmse_n.in_phase
            for figures in summary.of_each_contactor().values()
            if figures.force_rmse_n.in_phase is not None
        ),
        default=None,
    )
    off = "" if off_n is None else f", off by {1e3 * off_n:.1f} mN in phase"
    # Beyond the range of the histogram its end is a lower bound.
    over, beyond = ("over " if name in network.beyond else "" for name in ("p50", "p99"))
    tail = ""
    if network.p99 is not None:
        share = f"99 % within {network.p99:.1f} ms"
        tail = f" ({f'at most {network.max:.1f} ms' if beyond and network.max else share})"
    yield _in_time(
        summary,
        f"the finger felt the pulse {max(felt_ms, 0.0):.1f} ms after the wrist on average"
        f"{ahead}{off}; the network took {over}{network.p50:.1f} ms{tail}.",
    )


def _lost(summary: Summary) -> Iterator[str]:
    """Yield what was lost of the samples, and of a press's set-points."""
    samples = summary.samples
    if not samples.sent:
        return
    lost, late = samples.lost or 0, samples.late or 0
    if not lost and not late:
        text = f"None of the {samples.sent} samples was lost or came too late."
    else:
        share = _percent((lost + late) / samples.sent)
        parts = (f"{lost} were lost" if lost else "", f"{late} came too late" if late else "")
        text = f"Of {samples.sent} samples, {' and '.join(filter(None, parts))} ({share})"
        stops = summary.faults or summary.interruptions.count
        smooth = not stops and not summary.compensation.corrections
        text += "; the finger felt no gap." if smooth else "."
    if summary.press.lost:
        text += f" Of {summary.press.sent} set-points, {summary.press.lost} were lost."
    yield text


def _wrong(summary: Summary) -> Iterator[str]:
    """Yield what is wrong and what to do about it, the worst first.

    Where nothing was felt, the first line of the verdict has the reason, and the rest follows from
    it.
    """
    if not summary.availability.felt:
        return
    stops = summary.interruptions
    if stops.count and stops.seconds is not None:
        times = "once" if stops.count == 1 else f"{stops.count} times"
        yield f"The pulse stopped {times}, for {stops.seconds:.1f} s: no samples came in time."
    worst, missed = summary.loop.worst_5s, summary.availability.missed or 0.0
    if missed <= MOST_MISSED and (
        (worst.missed or 0.0) > LATE_TICKS or (worst.gap_ms or 0.0) > LONG_GAP_MS
    ):
        yield (
            f"This computer was too busy: in the worst 5 s {_percent(worst.missed)} of the ticks"
            f" were missed; {DOCTOR}."
        )
    yield from note_lines(summary.notes)
    for name, figures in summary.of_each_contactor().items():
        of = f" at {name}" if name else ""
        if figures.within_jnd is not None and figures.within_jnd < 1 - NOTICED:
            yield _in_time(
                summary,
                f"the error{of} was large enough to notice for {_percent(1 - figures.within_jnd)}"
                " of the time: --details shows prediction and limits.",
            )
        yield from _limits(figures.limited, of)
    for who, rejected in (
        ("Refused", summary.rejected),
        ("Refused readers of the telemetry", summary.rejected_readers),
    ):
        if refused := _unusual(rejected):
            others = refused.total() - max(refused.values())
            yield f"{who}: {_most(refused)}{f', and {others} others' if others else ''}."


def note_lines(notes: Iterable[Note]) -> Iterator[str]:
    """Yield a line on each part of which there are notes."""
    names = ("The film's sensor", "The sensing node", "The recorder")
    for of, texts in zip(names, texts_by_part(notes), strict=True):
        if texts:
            yield f"{of}: {'; '.join(texts)}."


def _limits(limits: Limits, of: str) -> Iterator[str]:
    """Yield the limits that cut the pulse for a part of the time; of: " at " a contactor, or ""."""
    named = {
        "the force limit cut the pulse": (limits.force, "check `preload` and the layers"),
        "the actuator was at the end of its travel": (
            limits.travel,
            "check `travel` and the layer",
        ),
        "the film was beyond its ADC's range": (limits.film, "lower the film's gain"),
        "the wrist's signal was beyond its ADC's range": (limits.adc, "lower the sensor's gain"),
    }
    for what, (limited, remedy) in named.items():
        if (limited.share or 0.0) > LIMITED:
            yield f"For {_percent(limited.share)} of the time {what}{of}: {remedy}."


def _unusual(rejected: Mapping[str, int]) -> Counter[str]:
    """Return the refusals that do not belong to every run, by cause."""
    return Counter({cause: n for cause, n in rejected.items() if n and cause not in USUAL})


def _most(refused: Counter[str]) -> str:
    """Return the meaning of the most frequent cause, and its count."""
    ((cause, count),) = refused.most_common(1)
    return f"{CAUSE_MEANINGS.get(cause, cause)} ({count} times)"


def _percent(share: float | None) -> str:
    """Return a share in percent, with a digit after the point below 10 %; a small one as less."""
    percent = 100 * (share or 0.0)
    if 0 < percent < LEAST_PERCENT:
        return f"less than {LEAST_PERCENT} %"
    return f"{percent:.0f} %" if percent >= 10 else f"{percent:.1f} %"
