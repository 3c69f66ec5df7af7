"""Supervision of one drive: commands within its limits, its faults, and the withdrawal after them.

After any fault, the tip is withdrawn as long as the drive accepts commands. One class decides this
for all kinds of drive, so that it depends neither on the kind nor on the order in which threads run
(decision 29). Pure: times are arguments in ns on the monotonic clock. The caller serialises the
calls by a `TimeoutLock`.
"""

import math
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from protocol.faults import Fault, FaultKind, Part
from pulse_drives.axis import Axis
from pulse_drives.following_error import CommandedPosition, FollowingError
from pulse_drives.withdrawal import Withdrawal, WithdrawalOutcome

# The loop holds the lock for microseconds, or while a full bus accepts a command: 50 ms at most.
PATIENCE_S = 0.05
# A TMCL module's position is read every 40 ms where commands keep its line busy: five of these.
POSITION_WITHIN_NS = 200_000_000
# Faults that show that the film's readings are wrong. A force that is too large, or rises too fast,
# may be there: the motor may turn the wrong way.
FILM_IS_WRONG = frozenset(
    (
        FaultKind.NOT_A_NUMBER,
        FaultKind.SILENT,
        FaultKind.LATE,
        FaultKind.TOO_LOW,
        FaultKind.OFF_FINGER,
        FaultKind.FROZEN,
    )
)
# Without a command for this time, a withdrawal is unconfirmed: the drive's thread hangs. Counted in
# steps of at most UNSENT_STEP_NS between two calls of `Supervisor.status`.
UNSENT_NS = 400_000_000
UNSENT_STEP_NS = 20_000_000
GIVEN_UP = (WithdrawalOutcome.UNCONFIRMED, WithdrawalOutcome.WRONG_WAY)
Silence = tuple[FaultKind, str]
"""Kind of the fault of a drive that is not understood, and its words before the time."""
NO_ANSWER: Silence = (FaultKind.NO_ANSWER, "no answer")


class TimeoutLock:
    """Lock of a drive's commands, between the loop's thread and the drive's own.

    The loop's thread uses `with lock`. A loop that stalls while it holds the lock must not prevent
    the drive's thread from withdrawing the tip. So that thread uses
    `with lock.acquire_or_proceed()`, which proceeds without the lock after a timeout. Both threads
    may then use the data at once: it is replaced in one step, and a time may be older than the last
    one.

    Parameters
    ----------
    lock
        A lock that other code shares; a new one by default.
    """

    def __init__(self, lock: "threading.Lock | None" = None) -> None:
        self._lock = threading.Lock() if lock is None else lock
        self._timed_out = False

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    @contextmanager
    def acquire_or_proceed(self) -> Iterator[None]:
        """Acquire the lock with a timeout of `PATIENCE_S`, and proceed without it after that.

        Until the lock is free again, further calls do not wait, because a withdrawal requires a
        command every few milliseconds.
        """
        held = self._lock.acquire(timeout=0.0 if self._timed_out else PATIENCE_S)
        self._timed_out = not held
        try:
            yield
        finally:
            if held:
                self._lock.release()


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """The last report of a drive.

    Attributes
    ----------
    position_m
        Tip position in m from first touch, positive into the finger.
    fault
        Fault since which commands are ignored, until `Drive.start` is called again; or None.
    moving
        The drive reports a speed.
    received_ns
        Time of the position on the monotonic clock; 0 before any.
    withdrawal
        State of the withdrawal since the fault; None without a fault, or if the direction of the
        drive was not verified.
    answered_ns
        Time of the drive's last answer of any kind.
    held_back
        The last command was slowed before the far end of the travel.
    """

    position_m: float
    speed_m_per_s: float
    fault: Fault | None
    moving: bool
    received_ns: int
    withdrawal: WithdrawalOutcome | None = None
    answered_ns: int = 0
    held_back: bool = False


class Supervisor:
    """Supervision of one drive: bounds its speed, latches its first fault and withdraws its tip.

    watchdog_ns, held_ns: as in `DriveScene`. part: the drive, as faults name it.

    Attributes
    ----------
    fault
        The first fault, until `arm`; None while there is none.
    withdrawal
        The withdrawal since the fault.
    verified
        The motor turns in the commanded direction. Until that is known, a fault leaves the drive at
        rest, because a withdrawal might move towards the finger.
    origin_m
        Position of the finger, at most 0: below 0 where it has followed a tip that yields.
    position_m, position_ns
        Last reported position in m from first touch, and its time.
    answered_ns
        Time of the drive's last answer of any kind.
    """

    def __init__(self, axis: Axis, watchdog_ns: int, held_ns: int, part: Part = Part.DRIVE) -> None:
        self._axis = axis
        self._part = part
        self._watchdog_ns = watchdog_ns
        # Only a drive that brakes before its watchdog's time is assumed to have braked: a watchdog
        # may act late, and a withdrawal must then not begin too near.
        held = held_ns if held_ns < watchdog_ns else math.inf
        self._commanded = CommandedPosition(held_ns=held)
        self._following = FollowingError(axis.max_acceleration_m_per_s2, held)
        # The loop's last speed, and its time; 0 before the first.
        self._target = (0.0, 0)
        self._stepped_ns = 0
        # Of `status`: its last call, the last command of the withdrawal that it has seen, and the
        # time since.
        self._asked_ns = self._seen_ns = self._unsent_ns = 0
        self._held_back = False
        self.fault: Fault | None = Fault(FaultKind.NOT_STARTED, part, "not started")
        self.withdrawal: Withdrawal | None = None
        self.verified = False
        self.origin_m = 0.0
        self.position_m = axis.lowest_m
        self.position_ns = self.answered_ns = 0

    def hangs(self, now_ns: int) -> bool:
        """Return whether `check_silence` was not called for far longer than the drive waits."""
        return now_ns - self._stepped_ns > self._watchdog_ns + UNSENT_NS

    @property
    def commanded_ns(self) -> int:
        """Time of the loop's last command; 0 before the first."""
        return self._target[1]

    def arm(self, now_ns: int) -> None:
        """Follow the loop's commands from now on, and forget an earlier fault."""
        self.fault = self.withdrawal = None
        self.verified = False
        self.origin_m = 0.0
        self._following.begin()
        self.position_ns = self.answered_ns = self._stepped_ns = now_ns
        self.pause()

    def pause(self) -> None:
        """Rest; the watchdog starts with the loop's first command."""
        self._target = (0.0, 0)

    def set_target(self, speed_m_per_s: float, now_ns: int) -> None:
        """Store the loop's speed, positive into the finger; the latest one counts."""
        self._target = (speed_m_per_s, now_ns)

    def add_position(self, position_m: float, now_ns: int) -> None:
        """Take a position that the drive reported, in m from first touch."""
        # If the host has stalled, the drive's own watchdog stopped the drive; that is no following
        # error of the drive.
        self.check_silence(now_ns)
        self.position_m = position_m
        self.position_ns = self.answered_ns = now_ns
        if self.withdrawal is not None:
            self.withdrawal.add_position(position_m, now_ns)
        if self.fault is None:
            self._following.add_position(position_m, now_ns)
            if self._following.failed:
                error_um = self._following.error_m * 1e6
                cause = (
                    f"following error: it reports {abs(error_um):.0f} µm"
                    f" {'more' if error_um > 0 else 'less'} than was commanded"
                )
                self.fail(Fault(FaultKind.FOLLOWING_ERROR, self._part, cause, now_ns))

    def add_force_reading(self, force_n: float, taken_ns: int) -> None:
        """Take a reading in N of the film under the finger, or of the probe's load cell."""
        if self.withdrawal is not None:
            self.withdrawal.add_force_reading(force_n, taken_ns)

    def fail(self, fault: Fault, film_trusted: bool = True) -> None:
        """Latch a fault and begin the withdrawal, at the fault's time; a second changes nothing.

        film_trusted: the film of this drive was not found wrong.
        """
        if self.fault is not None:
            return
        now_ns = fault.at_ns
        if self.verified:
            # NaN before the first report: then the reported position stands alone.
            furthest_m = max(self.position_m, self.commanded_m(now_ns))
            self.withdrawal = Withdrawal(
                now_ns,
                min(furthest_m, self._axis.furthest_m),
                self.travel_m(now_ns),
                self._axis.clear_of(self.origin_m),
                trusted=not self._following.failed,
                film_trusted=film_trusted,
            )
        # Set last, so that no other thread sees a fault without its withdrawal.
        self.fault = fault

    def mark_unsent(self, now_ns: int) -> None:
        """Note that a command may not have reached the drive, so its travel does not count."""
        if self.withdrawal is not None:
            self.withdrawal.restart(now_ns, self.travel_m(now_ns))

    def check_silence(self, now_ns: int, silence: Silence = NO_ANSWER) -> None:
        """Latch a fault if no command, answer or position has come for too long.

        Call it often. A pause between calls is a stall of the host, in which no command was sent
        and no answer received. silence: kind and name of the fault without answers.
        """
        stalled_ns = now_ns - self._stepped_ns
        self._stepped_ns = max(now_ns, self._stepped_ns)
        if self.fault is not None:
            return
        commanded_ns = self.commanded_ns
        uncommanded_ns = max(stalled_ns, now_ns - commanded_ns if commanded_ns else 0)
        silent_ns = now_ns - self.answered_ns
        part = self._part
        if uncommanded_ns > self._watchdog_ns:
            kind, part, words, for_ns = (
                FaultKind.NO_COMMAND,
                Part.LOOP,
                "no command",
                uncommanded_ns,
            )
        elif silent_ns > self._watchdog_ns:
            (kind, words), for_ns = silence, silent_ns
        elif now_ns - self.position_ns > max(POSITION_WITHIN_NS, self._watchdog_ns):
            kind, words, for_ns = FaultKind.NO_POSITION, "no position", now_ns - self.position_ns
        else:
            return
        self.fail(Fault(kind, part, f"{words} for {for_ns * 1e-6:.0f} ms", now_ns))

    def velocity_to_send(self, now_ns: int) -> int:
        """Return the velocity to send now, in the drive's units; then call `mark_sent`."""
        if self.withdrawal is not None:
            speed = self.withdrawal.speed_m_per_s(now_ns, self.travel_m(now_ns))
            # Where steps are lost, the count is home before the tip is.
            if self._is_at_home and not self.withdrawal.film_shows_press(now_ns):
                speed = 0.0
            speed = max(speed, -self._axis.max_speed_m_per_s)
        elif self.fault is not None:
            speed = 0.0
        else:
            speed = self._within_limits(self._target[0], now_ns)
        return self._axis.units.velocity(speed)

    @property
    def _is_at_home(self) -> bool:
        return not self._following.failed and self.position_m <= self._axis.lowest_m

    def mark_sent(self, velocity: int, now_ns: int) -> None:
        """Record a velocity in the drive's units that was sent at a time."""
        speed_m_per_s = self._axis.units.speed_m_per_s(velocity)
        self._commanded.record(speed_m_per_s, now_ns)
        self._following.record(speed_m_per_s, now_ns)

    def status(self, speed_m_per_s: float, now_ns: int) -> DriveStatus:
        """Return the drive's status; the speed is what the drive reported last, in m/s.

        Call it often: a withdrawal for which nothing is sent meanwhile is unconfirmed.
        """
        return DriveStatus(
            self.position_m,
            speed_m_per_s,
            self.fault,
            speed_m_per_s != 0,
            self.position_ns,
            self._withdrawal_outcome(now_ns),
            self.answered_ns,
            self._held_back,
        )

    def _withdrawal_outcome(self, now_ns: int) -> WithdrawalOutcome | None:
        withdrawal = self.withdrawal
        passed_ns, self._asked_ns = now_ns - self._asked_ns, now_ns
        if withdrawal is None:
            return None
        if withdrawal.sent_ns != self._seen_ns:
            self._seen_ns, self._unsent_ns = withdrawal.sent_ns, 0
        # A stall of the whole host is none of the drive's thread.
        self._unsent_ns += min(passed_ns, UNSENT_STEP_NS)
        outcome = withdrawal.outcome
        if outcome is WithdrawalOutcome.UNDER_WAY and self._unsent_ns > UNSENT_NS:
            return WithdrawalOutcome.UNCONFIRMED
        return outcome

    def commanded_m(self, now_ns: int) -> float:
        """Return the commanded position in m from first touch; NaN before the first report."""
        return self._following.position_m(now_ns)

    def travel_m(self, now_ns: int) -> float:
        """Return the commanded travel in m until a time, from an arbitrary origin."""
        return self._commanded.travel_m(now_ns)

    def _within_limits(self, speed_m_per_s: float, now_ns: int) -> float:
        axis, limit = self._axis, self._axis.max_speed_m_per_s
        wanted = min(max(speed_m_per_s, -limit), limit)
        age_s, origin_m = (now_ns - self.position_ns) * 1e-9, self.origin_m
        bounded = axis.bounded(wanted, self.position_m, age_s, origin_m)
        # The commanded position is bounded too, in case the reported one is wrong.
        commanded_m = self.commanded_m(now_ns)
        # NaN before the first report.
        if commanded_m == commanded_m:
            bounded = axis.bounded(bounded, commanded_m, 0.0, origin_m)
        self._held_back = 0 <= bounded < wanted
        return bounded
