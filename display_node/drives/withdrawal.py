"""Taking the tip off the finger: how fast, until when, and what came of it.

Slow until position or film confirms that it goes away from the finger, then fast. A position or a
force that goes the other way stops it at once. Where nothing confirms it, it ends by the way
that was commanded. Pure: times come in, in ns on the monotonic clock.

The one sentence about the finger, from what is measured; every surface shows this one.
"""

from dataclasses import dataclass
from enum import Enum

# Away from the finger: unconfirmed, and confirmed. The second leaves a usual pulse in some 30 ms.
SLOW_M_PER_S = 10e-3
FAST_M_PER_S = 20e-3
# What moved towards the finger when it began may take so long to turn, by reports that are late.
TURN_NS = 30_000_000
# The same by the film, whose readings are older.
FILM_TURN_NS = 50_000_000
CONFIRMED_M = 30e-6
WRONG_WAY_M = 100e-6
CONFIRMED_N = 0.02
WRONG_WAY_N = 0.05
# Of the highest reading; beyond the fixed part, as noise grows with the sensor's range.
SHARE = 0.1
# Reports or readings in a row: one alone may be wrong.
IN_A_ROW = 3
# Where nothing is sent for so long, the host has stalled: the drive goes on by its last command
# until its own watchdog ends it, and must turn again.
PAUSE_NS = 30_000_000
# Without a confirmation for so long, the commanded way bounds it, and this much more.
PATIENCE_NS = 150_000_000
MARGIN_M = 0.5e-3
# Without a report for so long the drive was not reached.
SILENT_NS = 50_000_000
# A film that reads more than this after the commanded way is pressed still.
PRESSED_N = 0.05


class WithdrawalOutcome(Enum):
    """State of a withdrawal.

    UNCONFIRMED: it was commanded whole, and the drive's position does not show it. WRONG_WAY: it
    went towards the finger, and was stopped.
    """

    UNDER_WAY = "under way"
    WITHDRAWN = "withdrawn"
    UNCONFIRMED = "unconfirmed"
    WRONG_WAY = "wrong way"


class Withdrawal:
    """One withdrawal of a tip, from its begin on.

    outcome: how far it has come. confirmed: position or film has shown that the tip goes away.
    """

    def __init__(
        self, now_ns: int, position_m: float, way_m: float, clear_m: float, trusted: bool
    ) -> None:
        """Begin.

        Parameters
        ----------
        now_ns
            When it begins.
        position_m
            Furthest position that the tip may have, in m from first touch.
        way_m
            Commanded way at this time, in m.
        clear_m
            Position where the tip is off the finger; negative.
        trusted
            Whether the drive's position is to be believed.
        """
        self._began_ns = self._counted_ns = self._turning_ns = self._sent_ns = now_ns
        self._peak_m = self._last_m = position_m
        self._began_m = self._way_m = way_m
        self._heard_ns = now_ns
        self._clear_m = clear_m
        self._blind_m = position_m - clear_m + MARGIN_M
        self._trusted = trusted
        self._peak_n = self._last_n = 0.0
        self._rising = self._astray = 0
        self._relieved = self.confirmed = False
        self.outcome = WithdrawalOutcome.UNDER_WAY

    def report(self, position_m: float, heard_ns: int) -> None:
        """Take a position that the drive reported, in m from first touch."""
        silent_ns, self._heard_ns = heard_ns - self._heard_ns, heard_ns
        self._last_m = position_m
        if self.outcome is WithdrawalOutcome.UNCONFIRMED and silent_ns > SILENT_NS:
            # It is reached again, and what was commanded meanwhile may not have reached it.
            self.renew(heard_ns, self._way_m)
        if (
            not self._trusted
            or heard_ns <= self._began_ns
            or self.outcome is WithdrawalOutcome.WRONG_WAY
        ):
            return
        if self._may_turn(heard_ns, TURN_NS):
            self._peak_m = max(self._peak_m, position_m)
        elif position_m > self._peak_m + WRONG_WAY_M:
            self._astray += 1
            if self._astray >= IN_A_ROW:
                self.outcome = WithdrawalOutcome.WRONG_WAY
            return
        self._astray = 0
        self.confirmed |= position_m < self._peak_m - CONFIRMED_M
        if position_m <= self._clear_m:
            self.outcome = WithdrawalOutcome.WITHDRAWN

    def press(self, force_n: float, taken_ns: int) -> None:
        """Take a reading of the film, in N."""
        self._last_n = force_n
        if self.outcome is not WithdrawalOutcome.UNDER_WAY:
            return
        if self._may_turn(taken_ns, FILM_TURN_NS):
            self._peak_n = max(self._peak_n, force_n)
        elif force_n > (1 + SHARE) * self._peak_n + WRONG_WAY_N:
            self._rising += 1
            if self._rising >= IN_A_ROW:
                self.outcome = WithdrawalOutcome.WRONG_WAY
            return
        self._rising = self._astray = 0
        self._relieved |= force_n < (1 - SHARE) * self._peak_n - CONFIRMED_N
        self.confirmed |= self._relieved

    def renew(self, now_ns: int, way_m: float) -> None:
        """Count time and way anew: what was commanded until now may not have moved the motor."""
        self._counted_ns, self._began_m = now_ns, way_m
        if self.outcome is WithdrawalOutcome.UNCONFIRMED:
            self.outcome = WithdrawalOutcome.UNDER_WAY

    def speed_m_per_s(self, now_ns: int, way_m: float) -> float:
        """Return the speed to command now, negative or 0; way_m is the commanded way by now."""
        self._way_m = way_m
        if now_ns - self._sent_ns > PAUSE_NS:
            # Its watchdog has ended the last command, whose way was counted on.
            self._turning_ns = now_ns
            self.renew(now_ns, way_m)
        self._sent_ns = now_ns
        if self.outcome is WithdrawalOutcome.UNDER_WAY:
            # Until its position is to be expected, and as long as it comes after that.
            since_ns = max(self._counted_ns, self._heard_ns) if self.confirmed else self._counted_ns
            bounded = not (self._trusted and now_ns - since_ns < PATIENCE_NS)
            if bounded and self._began_m - way_m >= self._blind_m:
                relieved = self._relieved and self._last_n <= PRESSED_N
                there = relieved or self._last_m <= self._clear_m
                self.outcome = (
                    WithdrawalOutcome.WITHDRAWN if there else WithdrawalOutcome.UNCONFIRMED
                )
        if self.outcome is WithdrawalOutcome.UNCONFIRMED and self._last_n > PRESSED_N:
            return -SLOW_M_PER_S
        if self.outcome is not WithdrawalOutcome.UNDER_WAY:
            return 0.0
        return -(FAST_M_PER_S if self.confirmed else SLOW_M_PER_S)

    def _may_turn(self, taken_ns: int, within_ns: int) -> bool:
        """Return whether a motion towards the finger at that time may be an older command's."""
        return taken_ns - self._turning_ns < within_ns or taken_ns - self._sent_ns > PAUSE_NS


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
