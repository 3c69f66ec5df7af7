"""The one sentence about the finger, from what is measured; every surface shows this one."""

from dataclasses import dataclass

from display_node.drives.withdrawal import WithdrawalOutcome

# Below this a finger feels nothing, and a film's noise is no press.
TOUCH_N = 0.01


@dataclass(frozen=True, slots=True)
class FingerState:
    """The measured state of the finger.

    force_n: newest force in N, None where nothing measures it now; unknown_s: for how long not.
    measured_by: "" for the film, else what stands for it. outcome: of the drive's withdrawal, None
    where there is none. answers: the drive answers. fault: something is latched.
    """

    force_n: float | None
    unknown_s: float = 0.0
    measured_by: str = ""
    outcome: WithdrawalOutcome | None = None
    answers: bool = True


def describe_finger(state: FingerState) -> str:
    """Return what is known of the finger, in one sentence.

    Examples: "withdrawn"; "pressed with 245 mN, the drive does not answer"; "force unknown since
    3 s, withdrawing".
    """
    force = _force(state)
    if not state.answers:
        return f"{force}, the drive does not answer"
    match state.outcome:
        case WithdrawalOutcome.WITHDRAWN:
            return _withdrawn(state, force)
        case WithdrawalOutcome.UNDER_WAY:
            return f"{force}, withdrawing"
        case WithdrawalOutcome.UNCONFIRMED:
            return f"{force}, the drive does not confirm its withdrawal"
        case WithdrawalOutcome.WRONG_WAY:
            return f"{force}, withdrawal stopped as it went towards the finger"
        case _:
            return force


def _force(state: FingerState) -> str:
    force_n = state.force_n
    if force_n is None:
        return f"force unknown since {state.unknown_s:.0f} s"
    by = f" ({state.measured_by})" if state.measured_by else ""
    if abs(force_n) < TOUCH_N:
        return f"not pressed{by}"
    return f"pressed with {force_n * 1e3:.0f} mN{by}"


def _withdrawn(state: FingerState, force: str) -> str:
    """Describe a withdrawal that the position shows; the film may contradict it, or read
    nothing."""
    if state.force_n is None:
        return f"withdrawn by the drive's position, {force}"
    if abs(state.force_n) < TOUCH_N:
        return "withdrawn"
    return f"{force}, although the drive reports the tip withdrawn"
