"""The state of the finger as a display measures it, and the sentence that a person reads of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

# A force below this is not felt and may be the film's noise: it does not count as a press.
TOUCH_N = 0.01


class WithdrawalOutcome(StrEnum):
    """State of a withdrawal.

    WITHDRAWN: the position shows the tip off the finger, and a film that can be trusted shows no
    force. RELIEVED: the film alone shows that no force is left; the position is unknown.
    UNCONFIRMED: the whole travel was commanded, and neither is shown. WRONG_WAY: the tip went
    towards the finger, and was stopped.
    """

    UNDER_WAY = "under way"
    WITHDRAWN = "withdrawn"
    RELIEVED = "relieved"
    UNCONFIRMED = "unconfirmed"
    WRONG_WAY = "wrong way"


@dataclass(frozen=True, slots=True)
class FingerState:
    """The measured state of the finger; nothing is known where all is None."""

    #: Newest force in N; None where nothing measures it now.
    force_n: float | None = None
    #: Time in s since the last measurement.
    unknown_s: float | None = None
    #: Source of the force, if it is not the film.
    measured_by: str | None = None
    #: State of the drive's withdrawal; None where there is none.
    outcome: WithdrawalOutcome | None = None
    #: The drive answers; None where there is none.
    answers: bool | None = None

    @property
    def pressed(self) -> bool:
        """True where a force is measured that is felt."""
        return self.force_n is not None and abs(self.force_n) >= TOUCH_N

    @property
    def withdrawn(self) -> bool:
        """True where position and force show the tip off the finger."""
        done = self.outcome is WithdrawalOutcome.WITHDRAWN and self.answers is not False
        return done and self.force_n is not None and not self.pressed


_DURING = {
    WithdrawalOutcome.UNDER_WAY: "withdrawing",
    WithdrawalOutcome.RELIEVED: "the drive's position is unknown",
    WithdrawalOutcome.UNCONFIRMED: "the drive does not confirm its withdrawal",
    WithdrawalOutcome.WRONG_WAY: "withdrawal stopped as it went towards the finger",
}


def describe_finger(state: FingerState) -> str:
    """Describe the finger's measured state in the sentence that terminal, page and reports show.

    Examples: "withdrawn"; "pressed with 245 mN, the drive does not answer"; "force unknown since
    3 s, withdrawing". Empty where nothing is known.
    """
    force_n, by = state.force_n, f" ({state.measured_by})" if state.measured_by else ""
    if force_n is None and state.unknown_s is None:
        return ""
    if force_n is None:
        force = f"force unknown since {state.unknown_s:.0f} s"
    elif state.pressed:
        force = f"pressed with {force_n * 1e3:.0f} mN{by}"
    else:
        force = f"not pressed{by}"
    if state.answers is False:
        return f"{force}, the drive does not answer"
    if state.outcome is not WithdrawalOutcome.WITHDRAWN:
        return force if state.outcome is None else f"{force}, {_DURING[state.outcome]}"
    # The drive's position shows the withdrawal; the film may contradict it.
    if force_n is None:
        return f"withdrawn by the drive's position, {force}"
    return (
        "withdrawn" if state.withdrawn else f"{force}, although the drive reports the tip withdrawn"
    )


def finger_in(figures: Mapping[str, Any]) -> FingerState:
    """Return the state of the finger in a summary's JSON, or in that of a contactor."""
    plain = figures.get("finger") or {}
    outcome = plain.get("outcome")
    return FingerState(
        plain.get("force_n"),
        plain.get("unknown_s"),
        plain.get("measured_by"),
        None if outcome is None else WithdrawalOutcome(outcome),
        plain.get("answers"),
    )
