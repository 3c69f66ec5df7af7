"""Withdrawal of the tip from the finger.

A withdrawal is slow until position or film confirms that the tip leaves the finger, then fast. A
position or a force that changes in the wrong direction stops it at once. Without a confirmation it
ends after a commanded travel; while the film still reads a press, it continues slowly. Pure: times
are arguments in ns on the monotonic clock.
"""

from protocol.finger import TOUCH_N as TOUCH_N
from protocol.finger import WithdrawalOutcome as WithdrawalOutcome

# Speeds before and after the confirmation. At the second, the force of a usual pulse is gone after
# some 30 ms.
SLOW_M_PER_S = 10e-3
FAST_M_PER_S = 20e-3
# At the start, delayed reports may show a motion towards the finger for this time.
TURN_NS = 30_000_000
# The film's readings are older, and may show it for longer.
FILM_TURN_NS = 50_000_000
CONFIRMED_M = 30e-6
WRONG_WAY_M = 100e-6
CONFIRMED_N = 0.02
WRONG_WAY_N = 0.05
# CONFIRMED_N and WRONG_WAY_N are widened by this share of the highest reading, as noise grows with
# the sensor's range.
SHARE = 0.1
# Number of consecutive reports or readings that are needed, as a single one may be wrong.
IN_A_ROW = 3
# A longer pause between commands is a stall of the host. The drive keeps its last command until its
# own watchdog stops it, and must then reverse again.
PAUSE_NS = 30_000_000
# If no position shows the withdrawal, it ends when it has lasted this time and the travel to the
# clear position plus MARGIN_M was commanded.
PATIENCE_NS = 150_000_000
MARGIN_M = 0.5e-3
# After a longer time without a report, commands may not have reached the drive.
SILENT_NS = 50_000_000
# Above this reading after the commanded travel, the film is still pressed.
PRESSED_N = 0.05
# An older reading of the film, or position, shows nothing of the present.
FILM_SILENT_NS = POSITION_SILENT_NS = 100_000_000
# One that lasts longer counts as unconfirmed, and goes on. An axis that needs more than a second is
# refused.
OVERDUE_NS = 1_500_000_000


class _Rise:
    """Successive values beyond a bound.

    Only a motor that still turns the wrong way makes each greater than the last. Where the first
    commands were lost, or nobody read the film, the values are too great, but they fall.
    """

    def __init__(self) -> None:
        self.count = 0
        self.greatest = 0.0

    def goes_on(self, value: float) -> bool:
        """Return whether a value beyond the bound exceeds the last one, if that was, too."""
        if self.count and value <= self.greatest:
            return False
        self.count += 1
        self.greatest = value
        return True


class Withdrawal:
    """One withdrawal of a tip.

    Attributes
    ----------
    confirmed
        Position or film has shown that the tip leaves the finger.
    handed_over
        The drive's own board does the rest; the host sends it nothing more.
    stopped_by_film
        A film that can be trusted has shown the motion towards the finger.
    """

    def __init__(
        self,
        now_ns: int,
        position_m: float,
        travel_m: float,
        clear_m: float,
        trusted: bool,
        film_trusted: bool = True,
    ) -> None:
        """Begin the withdrawal.

        Parameters
        ----------
        position_m
            Furthest position that the tip may have, in m from first touch.
        travel_m
            Commanded travel at this time, in m.
        clear_m
            Position where the tip is off the finger; negative.
        trusted
            The drive's position can be used.
        film_trusted
            The film's readings can be used: they were not found at fault.
        """
        self._began_ns = self._counted_ns = self._turning_ns = self._sent_ns = now_ns
        self._peak_m = self._last_m = position_m
        self._counted_m = self._travel_m = travel_m
        self._received_ns = now_ns
        self._clear_m = clear_m
        self._unconfirmed_m = position_m - clear_m + MARGIN_M
        self._trusted, self._film_trusted = trusted, film_trusted
        # Since when the position shows the tip off the finger; 0 while it does not.
        self._clear_ns = 0
        # Last reading, and its time; None before any.
        self._film_ns: int | None = None
        self._peak_n = self._last_n = 0.0
        self._force, self._depth = _Rise(), _Rise()
        self._relieved = self.confirmed = self.handed_over = self.stopped_by_film = False
        # Time for which it is under way, without stalls of the host.
        self._lasted_ns = 0
        self._outcome = WithdrawalOutcome.UNDER_WAY

    @property
    def outcome(self) -> WithdrawalOutcome:
        """Its state; one that takes too long is unconfirmed, and goes on all the same."""
        if self._outcome is WithdrawalOutcome.UNDER_WAY and self._lasted_ns > OVERDUE_NS:
            return WithdrawalOutcome.UNCONFIRMED
        return self._outcome

    @property
    def sent_ns(self) -> int:
        """Time of the last command, or of the beginning."""
        return self._sent_ns

    def add_position(self, position_m: float, received_ns: int) -> None:
        """Take a position that the drive reported, in m from first touch."""
        silent_ns, self._received_ns = received_ns - self._received_ns, received_ns
        self._last_m = position_m
        if self._outcome is WithdrawalOutcome.UNCONFIRMED and silent_ns > SILENT_NS:
            # The drive answers again, and may have missed the commands of the silence.
            self.restart(received_ns, self._travel_m)
        wrong_way = self._outcome is WithdrawalOutcome.WRONG_WAY
        if wrong_way or not self._trusted or received_ns <= self._began_ns:
            return
        if self._may_turn(received_ns, TURN_NS):
            self._peak_m = max(self._peak_m, position_m)
        elif position_m > self._peak_m + WRONG_WAY_M:
            if self._depth.goes_on(position_m):
                if self._depth.count >= IN_A_ROW:
                    self._outcome = WithdrawalOutcome.WRONG_WAY
                return
            self._peak_m = self._depth.greatest
        self._depth.count = 0
        self.confirmed |= position_m < self._peak_m - CONFIRMED_M
        if position_m > self._clear_m:
            self._clear_ns = 0
        elif not self._clear_ns:
            self._clear_ns = received_ns
        if self._is_clear(received_ns):
            self._outcome = WithdrawalOutcome.WITHDRAWN

    def add_force_reading(self, force_n: float, taken_ns: int) -> None:
        """Take a reading in N of the film, or of the probe's load cell.

        One that was found at fault decides nothing.
        """
        if not self._film_trusted:
            return
        self._last_n, self._film_ns = force_n, taken_ns
        if self._outcome is not WithdrawalOutcome.UNDER_WAY:
            return
        if self._may_turn(taken_ns, FILM_TURN_NS):
            self._peak_n = max(self._peak_n, force_n)
        elif force_n > (1 + SHARE) * self._peak_n + WRONG_WAY_N:
            if self._force.goes_on(force_n):
                if self._force.count >= IN_A_ROW:
                    self._outcome = WithdrawalOutcome.WRONG_WAY
                    self.stopped_by_film = True
                return
            self._peak_n = self._force.greatest
        self._force.count = self._depth.count = 0
        self._relieved |= force_n < (1 - SHARE) * self._peak_n - CONFIRMED_N
        self.confirmed |= self._relieved

    def restart(self, now_ns: int, travel_m: float) -> None:
        """Count time and travel from now on, as earlier commands may not have moved the motor."""
        self._counted_ns, self._counted_m = now_ns, travel_m
        if self._outcome is WithdrawalOutcome.UNCONFIRMED:
            self._outcome = WithdrawalOutcome.UNDER_WAY

    def hand_over(self, now_ns: int) -> None:
        """Leave the rest to the drive's own board, whose positions alone show it from now on."""
        self.handed_over = True
        self._film_trusted = False
        self._began_ns = self._counted_ns = self._turning_ns = now_ns
        self._depth.count = self._lasted_ns = 0
        self._peak_m = self._last_m
        self._outcome = WithdrawalOutcome.UNDER_WAY

    def speed_m_per_s(self, now_ns: int, travel_m: float) -> float:
        """Return the speed to command now, negative or 0, for the travel commanded until now."""
        self._travel_m = travel_m
        self._lasted_ns += min(now_ns - self._sent_ns, PAUSE_NS)
        if self.handed_over:
            self._sent_ns = now_ns
            return 0.0
        if now_ns - self._sent_ns > PAUSE_NS:
            # The drive's watchdog has ended the last command, so the counted travel is too large.
            self._turning_ns = now_ns
            self.restart(now_ns, travel_m)
        self._sent_ns = now_ns
        travelled = self._counted_m - travel_m >= self._unconfirmed_m
        if self._outcome is WithdrawalOutcome.UNDER_WAY and (travelled or self._clear_ns):
            # Wait `PATIENCE_NS` from the start, or after a confirmation from the newest position:
            # reports lag behind the commands. Where the position shows the tip off the finger, the
            # film has so long to show it, too.
            since_ns = max(self._counted_ns, self._received_ns if self.confirmed else 0)
            since_ns = self._clear_ns or since_ns
            if not self._trusted or now_ns - since_ns >= PATIENCE_NS:
                self._outcome = self._shown(now_ns)
        if self._outcome is WithdrawalOutcome.UNDER_WAY:
            fast = self.confirmed and not self._clear_ns
            return -FAST_M_PER_S if fast else -SLOW_M_PER_S
        if self._outcome is not WithdrawalOutcome.UNCONFIRMED:
            return 0.0
        # Commands may be lost, or the motor held, until it obeys.
        goes_on = self._last_n > PRESSED_N or self._is_on_finger(now_ns)
        return -SLOW_M_PER_S if goes_on else 0.0

    def _is_on_finger(self, now_ns: int) -> bool:
        """Return whether a position of the present shows that the tip is not off the finger."""
        known = now_ns - self._received_ns <= POSITION_SILENT_NS < now_ns - self._began_ns
        return self._trusted and known and self._last_m > self._clear_m

    def _is_clear(self, now_ns: int) -> bool:
        """Return whether the position, and a film that can be trusted, show the tip off."""
        if not self._trusted or self._last_m > self._clear_m:
            return False
        return not self._film_is_known(now_ns) or self._last_n <= PRESSED_N

    def _shown(self, now_ns: int) -> WithdrawalOutcome:
        """Return what is shown once the whole travel was commanded."""
        if self._is_clear(now_ns):
            return WithdrawalOutcome.WITHDRAWN
        relieved = self._relieved and self._last_n <= PRESSED_N and self._film_is_known(now_ns)
        # A position that shows the tip on the finger contradicts the film.
        if relieved and not (self._trusted and self._received_ns > self._counted_ns):
            return WithdrawalOutcome.RELIEVED
        return WithdrawalOutcome.UNCONFIRMED

    def _film_is_known(self, now_ns: int) -> bool:
        return self._film_ns is not None and now_ns - self._film_ns <= FILM_SILENT_NS

    def film_shows_press(self, now_ns: int) -> bool:
        """Return whether a film that can be trusted shows that the tip still presses."""
        return self._film_is_known(now_ns) and self._last_n > PRESSED_N

    def _may_turn(self, taken_ns: int, within_ns: int) -> bool:
        """Return whether an older command explains a motion towards the finger at a time."""
        return taken_ns - self._turning_ns < within_ns or taken_ns - self._sent_ns > PAUSE_NS
