"""Compare a display's reports about itself with the record of its ticks."""

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from protocol.cli_options import FAULT_STATUS
from protocol.faults import faults_of
from protocol.finger import TOUCH_N, describe_finger, finger_in
from soak.claims import LineClaim, StatusClaim
from soak.felt import FeltLog
from soak.verdict import Check
from telepulse.telemetry.events import INTERRUPTED, EventDetector

# A status follows its tick: the forces agree except for rounding to 1 mN.
ROUNDING_N = 0.6e-3
# A line shows the last status, up to 0.2 s old, and is read some time after it was written.
SEEN_WITHIN_NS = 1_200_000_000
FORCE_SHARE, FORCE_MORE_N = 0.2, 0.01
# A terminal marks statuses older than 1 s; the rest is for a busy machine.
CURRENT_S, BUSY_S = 1.0, 1.0
SHARE_BAR, SHARE_MORE_S = 0.01, 0.05
HEART_RATE_TIMES = 1.5
# Events give the length of an interruption in units of 0.01 s, from tick to tick.
NAMED_TO_S = 0.02
_WITHOUT = re.compile(r"after (\d+\.\d+) s ")
# Window of the heart rate: after this time an impostor's forces no longer affect it.
FORGOTTEN_NS = 8_000_000_000
# Errors quoted in a verdict.
QUOTED = 2


def judge_claims(name: str, claims: int, errors: Sequence[str]) -> Check:
    """Judge statements of one kind, of which none may be wrong."""
    quoted = "; ".join(errors[:QUOTED])
    found = f"{len(errors)} of {claims} untrue" + (f": {quoted}" if errors else "")
    return Check(name, found, "none untrue", not errors if claims else None)


def judge_statuses(
    role: str, processes: Sequence[Sequence[StatusClaim]], tick_ns: int
) -> list[Check]:
    """Judge the statuses of a display; processes: those of each of its processes, in order."""
    claims = [claim for process in processes for claim in process]
    count = len(claims)
    shares = [error for process in processes for error in share_errors(process, tick_ns * 1e-9)]
    return [
        judge_claims(f"state of {role}", count, [x for y in claims for x in state_errors(y)]),
        judge_claims(f"finger of {role}", count, [x for y in claims for x in finger_errors(y)]),
        judge_claims(f"figures of {role}", count, [x for y in claims for x in figure_errors(y)]),
        judge_claims(
            f"availability of {role}", sum(len(process) > 1 for process in processes), shares
        ),
    ]


def state_errors(claim: StatusClaim) -> Iterator[str]:
    """Yield the errors in a status' state: "playing" means full strength."""
    if claim.state == "playing" and not claim.full:
        yield "playing, and not felt at full strength"
    # Before the last status a display may have received the end of the pulse.
    if claim.full and claim.state != "playing" and not claim.final:
        yield f"{claim.state}, and felt at full strength"
    faults = faults_of(claim.summary)
    if (claim.state == "fault") != bool(faults):
        yield f"{claim.state}, with the faults {list(map(str, faults))}"


def finger_errors(claim: StatusClaim) -> Iterator[str]:
    """Yield the errors in a status' state of the finger."""
    finger, felt_n = finger_in(claim.summary), claim.felt_n
    if finger.force_n is not None:
        wrong = not abs(finger.force_n - felt_n) <= ROUNDING_N
    else:
        wrong = finger.unknown_s is None
    if wrong:
        yield f"{describe_finger(finger)!r}, and {felt_n * 1e3:.1f} mN were felt"


def figure_errors(claim: StatusClaim) -> Iterator[str]:
    """Yield the inconsistencies between the figures of a status."""
    for key in claim.no_figures:
        yield f"{key} is NaN or infinite"
    samples, shares = claim.summary["samples"], claim.summary["availability"]
    parts = [samples[key] for key in ("played", "predicted", "late", "lost")]
    if samples["sent"] is not None and None not in parts and samples["sent"] != sum(parts):
        yield f"{samples['sent']} sent, and {'+'.join(map(str, parts))} accounted for"
    for key in ("felt", "played", "judged", "missed"):
        if shares[key] is not None and not -1e-9 <= shares[key] <= 1 + 1e-9:
            yield f"availability.{key} is {shares[key]:.3g}"
    within = claim.summary["within_jnd"]
    if within is not None and not 0 <= within <= 1:
        yield f"within JND {within:.3g} of the time"
    if None not in (shares["judged"], shares["felt"]) and shares["judged"] > shares["felt"] + 1e-9:
        yield f"{shares['judged']:.3%} judged, and {shares['felt']:.3%} felt"


def share_errors(claims: Sequence[StatusClaim], tick_s: float) -> Iterator[str]:
    """Yield wrong shares of the time between the first and last status of a process.

    Ticks of which no trace arrived widen the bar.
    """
    if len(claims) < 2:
        return
    first, last = claims[0], claims[-1]
    recorded = last.ticks - first.ticks
    ran = last.summary["loop"]["ticks"] - first.summary["loop"]["ticks"]
    span_s = (last.tick_ns - first.tick_ns) * 1e-9
    felt_s = (last.full_ticks - first.full_ticks) * tick_s
    found = {"seconds": span_s, "felt": felt_s, "missed": span_s - ran * tick_s}
    bar_s = SHARE_BAR * span_s + SHARE_MORE_S + abs(ran - recorded) * tick_s
    for key, expected_s in found.items():
        claimed_s = _seconds(last, key) - _seconds(first, key)
        if not abs(claimed_s - expected_s) <= bar_s:
            yield f"{key} {claimed_s:.2f} s of {span_s:.1f} s, {expected_s:.2f} s recorded"


def _seconds(claim: StatusClaim, key: str) -> float:
    shares = claim.summary["availability"]
    seconds: float = shares["seconds"] or 0.0
    return seconds if key == "seconds" else seconds * (shares[key] or 0.0)


def judge_lines(
    role: str,
    lines: Sequence[LineClaim],
    record: FeltLog,
    wrist_per_min: float | None,
    impostors: Sequence[tuple[int, int]] = (),
) -> list[Check]:
    """Judge the lines that a terminal showed of a display.

    record: the display's ticks. wrist_per_min: heart rate of the source; None where it is not
    known. impostors: start and end of each time in which forces without a heart rate were sent.
    """
    known = [
        line
        for line in lines
        if not any(a <= line.read_ns <= b + FORGOTTEN_NS for a, b in impostors)
    ]
    rates = [error for line in known for error in heart_rate_errors(line, record, wrist_per_min)]
    forces = [error for line in lines for error in line_errors(line, record)]
    ages = [error for line in lines for error in age_errors(line, record)]
    return [
        judge_claims(f"terminal of {role}: state and force", len(lines), forces),
        judge_claims(f"terminal of {role}: age", len(lines), ages),
        judge_claims(f"terminal of {role}: heart rate", len(known), rates),
    ]


def line_errors(line: LineClaim, record: FeltLog) -> Iterator[str]:
    """Yield the errors in a line's state and forces, at its time."""
    from_ns = line.read_ns - round((line.age_s or 0.0) * 1e9) - SEEN_WITHIN_NS
    felt = record.between(from_ns, line.read_ns)
    if line.state == "playing" and not felt.full:
        yield "playing, and not felt at full strength"
    if line.state != "playing" and felt.full and not felt.less:
        yield f"{line.state}, and felt at full strength"
    for force_n in line.forces_n:
        if felt.low_n is None or felt.high_n is None:
            yield f"{force_n * 1e3:.0f} mN, and nothing was felt"
        elif not fits(force_n, felt.low_n, felt.high_n):
            span = f"{felt.low_n * 1e3:.0f} to {felt.high_n * 1e3:.0f} mN"
            yield f"{force_n * 1e3:.0f} mN, and {span} were felt"
    if line.not_pressed and not (felt.low_n is not None and felt.low_n < TOUCH_N + FORCE_MORE_N):
        yield f"not pressed, and {(felt.low_n or 0) * 1e3:.0f} mN at least were felt"


def fits(force_n: float, low_n: float, high_n: float) -> bool:
    """Return whether a force agrees with the least and the greatest that was felt."""
    least_n = low_n - FORCE_SHARE * abs(low_n) - FORCE_MORE_N
    return least_n <= force_n <= high_n + FORCE_SHARE * abs(high_n) + FORCE_MORE_N


def age_errors(line: LineClaim, record: FeltLog) -> Iterator[str]:
    """Yield the errors in a line's age: a silent display must be shown as silent."""
    newest_ns = record.newest_ns(line.read_ns)
    if newest_ns is None:
        return
    silent_s = (line.read_ns - newest_ns) * 1e-9
    if line.state == "ended" and line.age_s is None:
        return  # the last line of a display that has ended
    if line.age_s is None:
        if silent_s > CURRENT_S + BUSY_S:
            yield f"as if current, and silent for {silent_s:.1f} s"
        return
    # A line may be read late, when the display has returned.
    before_ns = record.newest_ns(line.read_ns - round(BUSY_S * 1e9))
    before_s = 0.0 if before_ns is None else (line.read_ns - before_ns) * 1e-9
    if not silent_s - BUSY_S <= line.age_s <= max(silent_s, before_s) + BUSY_S:
        yield f"{line.age_s:.1f} s ago, and silent for {silent_s:.1f} s"
    if line.finger or line.heart_rate_per_min is not None:
        yield f"{line.age_s:.1f} s ago, and the finger or heart rate as if current"
    if line.age_s > 2 * CURRENT_S + 0.1 and not line.silent:
        yield f"{line.age_s:.1f} s ago, and not that no telemetry comes"


def heart_rate_errors(
    line: LineClaim, record: FeltLog, wrist_per_min: float | None
) -> Iterator[str]:
    """Yield the errors in a line's heart rate: it must be the source's, of a felt pulse."""
    rate = line.heart_rate_per_min
    if rate is None:
        return
    if not record.between(line.read_ns - SEEN_WITHIN_NS, line.read_ns).full:
        yield f"{rate:.0f} /min, and no pulse was felt"
    elif (
        wrist_per_min is not None
        and not wrist_per_min / HEART_RATE_TIMES <= rate <= wrist_per_min * HEART_RATE_TIMES
    ):
        yield f"{rate:.0f} /min, and {wrist_per_min:.0f} /min at the wrist"


def judge_events(
    role: str,
    processes: Sequence[Sequence[StatusClaim]],
    interruptions: Sequence[tuple[int, int, int]],
) -> Check:
    """Judge the events: each interruption of the pulse is reported once, and no other.

    interruptions: see `FeltLog.interruptions`.
    """
    errors = [error for process in processes for error in _event_errors(process, interruptions)]
    return judge_claims(f"interruptions of {role}", len(interruptions) or len(errors), errors)


def judge_stalls(
    role: str,
    processes: Sequence[Sequence[StatusClaim]],
    gaps: Sequence[tuple[int, int, bool]],
    faded_ns: int,
) -> Check:
    """Judge the ends of stalls: after one in which the pulse fades, it returns by a ramp.

    gaps: see `FeltLog.gaps`. faded_ns: time without samples after which the pulse has faded to 0 N.
    """
    stalls = [gap for gap in gaps if gap[1] - gap[0] > faded_ns]
    # Gaps with a missing trace are left out: there were ticks.
    spans = [
        (before.tick_ns, claim.tick_ns)
        for process in processes
        for before, claim in pairwise(process)
        if _whole(before, claim)
    ]
    errors = [
        f"at full strength after {(until_ns - from_ns) * 1e-9:.2f} s without a tick"
        for from_ns, until_ns, full in stalls
        if full and any(a <= from_ns and until_ns <= b for a, b in spans)
    ]
    return judge_claims(f"ends of stalls of {role}", len(stalls), errors)


def _event_errors(
    process: Sequence[StatusClaim], interruptions: Sequence[tuple[int, int, int]]
) -> Iterator[str]:
    """Yield the errors in the events of one process, from each status to the next.

    Statuses between which a trace is missing are left out: the felt force is not known.
    """
    watch, before = EventDetector(), None
    for claim in process:
        events = watch.take(claim.state, claim.summary, claim.tick_ns)
        named = [event.text for event in events if event.name == INTERRUPTED]
        if before is not None and _whole(before, claim):
            ended = [x for x in interruptions if before.tick_ns < x[1] <= claim.tick_ns]
            without_s = sum(until_ns - from_ns for from_ns, until_ns, _ in ended) * 1e-9
            count, named_s = _count(claim) - _count(before), sum(map(_without_s, named))
            if count != len(ended) or not abs(named_s - without_s) <= NAMED_TO_S:
                found = f"{len(ended)} of {without_s:.2f} s"
                yield f"{found}, and named {count} of {named_s:.2f} s"
        before = claim


def _whole(before: StatusClaim, claim: StatusClaim) -> bool:
    """Return whether every tick between two statuses was recorded."""
    ran: int = claim.summary["loop"]["ticks"] - before.summary["loop"]["ticks"]
    return ran == claim.ticks - before.ticks


def _count(claim: StatusClaim) -> int:
    count: int = claim.summary["interruptions"]["count"] or 0
    return count


def _without_s(text: str) -> float:
    """Return the seconds that an event of interruptions states."""
    found = _WITHOUT.match(text)
    return float("nan") if found is None else float(found[1])


def judge_ends(
    ends: Sequence[tuple[str, int | None, Mapping[str, Any], StatusClaim | None]],
) -> Check:
    """Judge the ends of displays that were stopped.

    ends: of each its name, exit status, the summary that it wrote, and its last status.
    """
    errors = []
    for role, status, summary, last in ends:
        faults = faults_of(summary)
        if status != (FAULT_STATUS if faults else 0):
            errors.append(f"{role}: status {status} with the faults {list(map(str, faults))}")
        if last is not None and last.final:
            for key in ("finger", "faults", "samples"):
                if summary[key] != last.summary[key]:
                    errors.append(
                        f"{role}: {key} {summary[key]}, and {last.summary[key]} at the end"
                    )
    return judge_claims("exit statuses and summaries", len(ends), errors)
