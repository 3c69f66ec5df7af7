"""Compare a display's reports about the finger with the force in the motor's record.

The display has no access to this record of the emulated drive: it has the film's readings and the
positions that the drive reports.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.cli_options import FAULT_STATUS
from protocol.faults import Fault
from protocol.finger import TOUCH_N, FingerState, WithdrawalOutcome, describe_finger
from soak.truth import FORCE_MORE_N, fits, judge_claims
from soak.verdict import Check

# A status is read some time after its film reading, which is some 10 ms old.
SEEN_WITHIN_NS = 300_000_000
# After a status with a fault the display has taken the tip off within this time.
LEFT_WITHIN_S = 1.0


@dataclass(frozen=True, slots=True)
class FingerClaim:
    """A status of the display on the bench; read_ns: when it arrived."""

    read_ns: int
    state: str
    finger: FingerState


@dataclass(frozen=True, slots=True)
class Round:
    """A round on the bench, with one fault.

    trouble: its name and length. claims: statuses until the display ended. status, faults, finger:
    exit status, faults and the finger's state at its end. time_ns, force_n: the motor's
    record, one value per millisecond.
    """

    trouble: str
    claims: Sequence[FingerClaim]
    status: int | None
    faults: Sequence[Fault]
    finger: FingerState
    time_ns: NDArray[np.int64]
    force_n: NDArray[np.float64]


def judge_bench(rounds: Sequence[Round], failures: Sequence[str]) -> list[Check]:
    """Judge the rounds on the bench; failures: benches on which the pulse was never felt."""
    claims = sum(len(each.claims) for each in rounds)
    finger = [
        f"{x.trouble}: {error}" for x in rounds for y in x.claims for error in finger_errors(y, x)
    ]
    ends = [f"{x.trouble}: {error}" for x in rounds for error in end_errors(x)]
    most_n = max((float(each.force_n.max()) for each in rounds), default=0.0)
    left = [seconds for each in rounds if (seconds := left_after_s(each)) is not None]
    worst_s = max(left, default=0.0)
    text = f"{worst_s:.2f} s at worst of {len(left)} faults; {most_n:.3f} N at most"
    done = ", ".join(each.trouble for each in rounds) or "none"
    return [
        Check("bench: troubles", f"{done}; {len(failures)} benches not felt", "one at least",
              bool(rounds)),
        judge_claims("bench: finger", claims, finger),
        judge_claims("bench: ends", len(rounds), ends),
        Check("bench: off the finger after a fault", text, f"within {LEFT_WITHIN_S:g} s",
              worst_s <= LEFT_WITHIN_S if left else None),
    ]  # fmt: skip


def finger_errors(claim: FingerClaim, of: Round) -> Iterator[str]:
    """Yield the errors in a status' state of the finger."""
    window = of.force_n[
        (of.time_ns >= claim.read_ns - SEEN_WITHIN_NS) & (of.time_ns <= claim.read_ns)
    ]
    if not len(window):
        return
    low_n, high_n = float(window.min()), float(window.max())
    felt = f"{low_n * 1e3:.0f} to {high_n * 1e3:.0f} mN were felt"
    finger, said = claim.finger, repr(describe_finger(claim.finger))
    done = finger.outcome is WithdrawalOutcome.WITHDRAWN and finger.answers is not False
    if done and not finger.pressed:
        later_n = of.force_n[of.time_ns >= claim.read_ns]
        if len(later_n) and later_n.max() > TOUCH_N:
            yield f"{said}, and {later_n.max() * 1e3:.0f} mN from then on"
    elif finger.pressed and finger.force_n is not None:
        if not fits(finger.force_n, low_n, high_n):
            yield f"{said}, and {felt}"
    elif finger.force_n is not None and low_n > TOUCH_N + FORCE_MORE_N:
        yield f"{said}, and {felt}"


def end_errors(of: Round) -> Iterator[str]:
    """Yield the errors at a display's end, such as a finger that is left pressed."""
    expected = FAULT_STATUS if of.faults else 0
    if of.status != expected:
        yield f"exit status {of.status} with the faults {list(map(str, of.faults))}"
    if of.force_n[-1] > TOUCH_N:
        yield f"left pressed with {of.force_n[-1] * 1e3:.0f} mN"
        if not of.finger.pressed:
            yield f"{describe_finger(of.finger)!r} at the end"


def left_after_s(of: Round) -> float | None:
    """Return the time in s from the first status with a fault until the tip was off for good.

    It is infinite if the tip stayed on, and None without such a status.
    """
    begin_ns = next((claim.read_ns for claim in of.claims if claim.state == "fault"), None)
    if begin_ns is None:
        return None
    pressed = np.flatnonzero(of.force_n > TOUCH_N)
    if not len(pressed):
        return 0.0
    if pressed[-1] == len(of.force_n) - 1:
        return float("inf")
    return max(0.0, float(of.time_ns[pressed[-1]] - begin_ns) * 1e-9)
