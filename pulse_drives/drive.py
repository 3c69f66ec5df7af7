"""The interface of real drives to the force loop, and the parts that all kinds share.

`start` brings a drive to first touch, and `command` sets its speed. A thread of the drive's own
withdraws the tip after a fault, even if the loop hangs.

To add a drive:

1. Write a package like `tmcl/`, with a `DriveDevice` (the drive at its bus) and a `Drive`.
2. Write its settings, a `DriveScene` whose `driver` names the `Drive`, and name them in `DRIVES`
   (`scene.py`), or in an entry point of another distribution (`docs/howto/plugins.md`).
3. Describe its keys in `docs/scenes.md`.
"""

import math
import threading
import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar, Protocol

from protocol.errors import DriveError, SceneError
from protocol.faults import Fault, FaultKind, Part, internal_fault
from protocol.host.guard import GuardedThread
from pulse_drives.axis import Axis
from pulse_drives.scene import DriveScene
from pulse_drives.supervisor import DriveStatus, Supervisor, TimeoutLock
from pulse_drives.withdrawal import OVERDUE_NS, WithdrawalOutcome

# Time between two commands on the way to first touch or to rest.
PERIOD_S = 2e-3
# Time constant of the approach, longer than any drive's interval of position reports.
TIME_CONSTANT_S = 0.1
REST_WITHIN_S = 1.0
# Travel from home towards the finger within which every home switch opens.
OPENED_M = 0.3e-3
# A search for home may exceed the travel by this: the switch's own travel, and an error of `touch`.
SEARCH_MARGIN_M = 1e-3
# Before first touch the tip must not press: a rise of the film's reading by this much is a press.
PRESSED_N = 0.1
# A withdrawal that takes longer is unconfirmed; a board's own one begins when the host gives up.
WITHDRAWN_WITHIN_S = 2 * OVERDUE_NS * 1e-9 + 0.5
# A step of the drive's thread may wait for a line's time-out.
THREAD_ENDS_WITHIN_S = 2.0
# With a wrong `inverted` or two swapped wires, every withdrawal would press. The drive's own count
# does not show this, so the home switch and the film must.
ADVICE = "look at inverted in its table and at the motor's wiring"


class TouchGuard:
    """Guard of a motion that must not press: away from finger or wrist, or to first touch."""

    def __init__(self, force_n: Callable[[], float | None]) -> None:
        """Take a function that returns the newest force in N, None without one."""
        self._force_n = force_n
        self._least_n = force_n()

    def __call__(self) -> None:
        """Raise DriveError if the force is far above its least value so far."""
        force_n = self._force_n()
        if force_n is None:
            return
        if self._least_n is None or force_n < self._least_n:
            self._least_n = force_n
        elif force_n > self._least_n + PRESSED_N:
            rise_mn = (force_n - self._least_n) * 1e3
            raise DriveError(
                FaultKind.WRONG_WAY,
                f"the force rises by {rise_mn:.0f} mN before first touch; {ADVICE}",
            )


def bound_search(axis: Axis, began_m: float, position_m: float) -> None:
    """Raise DriveError if a search for home has travelled further than home can be away."""
    most_m = axis.furthest_m - axis.lowest_m + SEARCH_MARGIN_M
    if abs(position_m - began_m) > most_m:
        raise DriveError(
            FaultKind.WRONG_WAY,
            f"no home switch found within {most_m * 1e3:.1f} mm;"
            f" {ADVICE}, and at touch and furthest",
        )


class DriveDevice(Protocol):
    """A drive at its bus or serial line. All methods except `close` raise DriveError.

    Attributes
    ----------
    position_m, speed_m_per_s
        Last reported position in m from first touch, and last reported speed.
    """

    position_m: float
    speed_m_per_s: float

    def configure(self) -> None:
        """Check and set up the drive, enable it and read its position."""

    def home(self, guard: Callable[[], None]) -> None:
        """Find the zero of positions; blocks. `guard` is called repeatedly, and may raise."""

    def end_search(self) -> None:
        """Stop, and switch back to speed commands."""

    def arm_watchdog(self) -> None:
        """Make the drive stop by itself when commands stop, from the next command on."""

    def close(self) -> None:
        """Stop the drive as well as its line allows, and close the line. Never raises."""


class FilmPort(Protocol):
    """The film that a drive's board reads, as a port of a `pulse_sensors.sensor.Sensor`.

    name: for people. A reading is the number of its millisecond, the board's time in µs, and the
    film's counts.
    """

    name: str

    def open(self) -> None:
        """Open the drive's line, unless it is open. Raises SourceError."""

    def read(self) -> list[tuple[int, int, int]]:
        """Wait for readings and return them; none on timeout. Raises DriveError if it is gone."""

    def close(self) -> None:
        """Release the line. Never raises."""


class Drive(ABC):
    """A stepper's drive that takes speeds.

    No exception of its device ends its thread or leaves its methods: it is a fault, after which the
    thread goes on to withdraw the tip.

    Attributes
    ----------
    counts
        Errors on the bus that the next message corrected, by name.
    """

    #: Greatest time between two steps of the drive's own thread.
    step_s: float
    #: What faults name.
    part: ClassVar[Part] = Part.DRIVE

    def __init__(self, scene: DriveScene, axis: Axis) -> None:
        self._axis = axis
        self._homing_speed = scene.homing_speed_m_per_s
        self._device: DriveDevice | None = None
        self._thread: GuardedThread | None = None
        self._woken = threading.Event()
        self._supervisor = Supervisor(axis, scene.watchdog_ns, scene.held_ns, self.part)
        # Protects supervisor and commands, which the loop's and the drive's threads use.
        self._lock = TimeoutLock()
        self.counts: Counter[str] = Counter()

    def start(self, force_n: Callable[[], float | None] = lambda: None) -> None:
        """Connect, check, enable, home, verify the direction and go to first touch; blocks.

        Parameters
        ----------
        force_n
            Function that returns the newest force in N, of film or load cell; None without one.

        Raises
        ------
        DriveError
            If any step fails; of kind `INTERNAL` for an exception that is none of the project's.
            The drive is then closed; a tip that went the wrong way is moved back first.
        """
        self.close()
        try:
            self._device = device = self._connect()
            try:
                self._start(device, force_n)
            except BaseException:  # Ctrl-C must not leave it moving either
                self.close()
                raise
        except (DriveError, SceneError):
            raise
        except Exception as error:
            fault = internal_fault(self.part, "start", error, time.perf_counter_ns())
            raise DriveError(fault.kind, f"it does not start: {fault.cause}") from error
        self._supervisor.verified = True

    def _start(self, device: DriveDevice, force_n: Callable[[], float | None]) -> None:
        home_m = began_m = self._axis.lowest_m
        guard = TouchGuard(force_n)
        try:
            device.configure()
            began_m = device.position_m
            device.home(guard)
            began_m = device.position_m
            device.arm_watchdog()
            self._follow(device)
            opened_m = min(OPENED_M, -home_m / 2)
            self._move_to(home_m + opened_m, guard)
            # Not every drive reports its home switch; then the search's success must suffice.
            if self._home_switch():
                raise DriveError(
                    FaultKind.WRONG_WAY,
                    f"the home switch is closed {opened_m * 1e3:.2g} mm from home, towards the"
                    f" finger; {ADVICE}",
                )
            self._move_to(0.0, guard)
            self._pause()
        except DriveError as error:
            if error.kind is FaultKind.WRONG_WAY:
                self._go_back(device, began_m)
            raise

    def _go_back(self, device: DriveDevice, position_m: float) -> None:
        """Move a tip that went the wrong way back to where that began, if it can be moved."""
        try:
            if self._thread is None:
                device.end_search()
                self._follow(device)
            self._move_to(position_m)
        except Exception as error:
            # The first error is raised anyway.
            self.counts[f"not moved back: {type(error).__name__}"] += 1

    def command(self, speed_m_per_s: float) -> None:
        """Run at a speed within the soft limits, positive into the finger, until the next command.

        Never waits for the drive; the latest command counts. Commands before `start` or after a
        fault are ignored. After the first one, the scene's `watchdog` time without a command is a
        fault, and the tip is withdrawn.
        """
        if self._supervisor.fault is not None:
            return
        with self._lock:
            now_ns = time.perf_counter_ns()
            self._guarded(self._read_reports, now_ns)
            self._supervisor.set_target(speed_m_per_s, now_ns)
            self._guarded(self._send, now_ns)

    def film_port(self, least_counts: float, most_counts: float) -> FilmPort:
        """Return the port of the film that the drive's board reads, which a `Sensor` opens.

        least_counts, most_counts: hard limits, beyond which the board takes the tip off the finger
        by itself from the next `start` on. Raises SceneError for a drive without one.
        """
        raise SceneError('[display.feedback] kind = "drive": this kind of drive reads no film')

    def add_force_reading(self, force_n: float, taken_ns: int) -> None:
        """Take a force of film or load cell in N, which shows whether a withdrawal succeeds."""
        with self._lock:
            self._supervisor.add_force_reading(force_n, taken_ns)

    def status(self) -> DriveStatus:
        """Return the drive's last report, without a request."""
        with self._lock:
            now_ns = time.perf_counter_ns()
            if self._device is None:
                return self._supervisor.status(0.0, now_ns)
            self._guarded(self._read_reports, now_ns)
            if self._thread is not None and self._supervisor.hangs(now_ns):
                # A thread that hangs does not find this by itself.
                self._supervisor.check_silence(now_ns)
            return self._supervisor.status(self._device.speed_m_per_s, now_ns)

    def travel_m(self, now_ns: int) -> float:
        """Return the commanded travel in m until a time, from an arbitrary origin."""
        with self._lock:
            return self._supervisor.travel_m(now_ns)

    def commanded_m(self, now_ns: int) -> float:
        """Return the commanded position in m from first touch at a time, which reports correct."""
        with self._lock:
            return self._supervisor.commanded_m(now_ns)

    def place_finger(self, origin_m: float) -> None:
        """Set the position of a finger that has followed the tip, from which depths count."""
        with self._lock:
            self._supervisor.origin_m = min(origin_m, 0.0)

    def withdraw(self, reason: Fault | None = None, film_trusted: bool = True) -> None:
        """Take the tip off the finger from now on, and keep it there until `start`.

        Never waits for the drive. The reason becomes the fault, unless there is one; None: the end
        of a run, which is no fault. film_trusted: the film of this tip, or the load cell, was not
        found wrong (`FILM_IS_WRONG`): else it decides nothing in the withdrawal.
        """
        if reason is None:
            reason = Fault(FaultKind.ENDED, self.part, "ended")
        with self._lock:
            self._supervisor.fail(replace(reason, at_ns=time.perf_counter_ns()), film_trusted)
        self._woken.set()

    def await_withdrawal(self, between: Callable[[], object] = bool) -> Fault | None:
        """Wait until a withdrawal has ended, as long as that may take.

        between: called again and again, for example to read the film. Returns the fault of a tip
        that may still press.
        """
        deadline_s = time.monotonic() + WITHDRAWN_WITHIN_S
        while (outcome := self.status().withdrawal) is WithdrawalOutcome.UNDER_WAY:
            if time.monotonic() > deadline_s:
                break
            between()
            time.sleep(PERIOD_S)
        if outcome in (None, WithdrawalOutcome.WITHDRAWN, WithdrawalOutcome.RELIEVED):
            return None
        cause = f"the tip may still press at the end, its withdrawal is {outcome.value}"
        return Fault(FaultKind.STILL_PRESSED, self.part, cause, time.perf_counter_ns())

    def close(self) -> None:
        """Bring the drive to rest, disable and disconnect it. Never raises.

        A withdrawal that is under way is waited for, as long as it may take.
        """
        device = self._device
        if device is None:
            return
        self._await_rest()
        thread, self._thread = self._thread, None
        if thread is not None:
            self._woken.set()
            if not thread.stop(THREAD_ENDS_WITHIN_S):
                self.counts["thread hangs"] += 1
        supervisor = self._supervisor
        supervisor.fault = supervisor.fault or Fault(FaultKind.CLOSED, self.part, "closed")
        self._device = None
        try:
            device.close()
        except Exception as error:
            self.counts[f"not closed: {type(error).__name__}"] += 1

    def _await_rest(self) -> None:
        """Wait until the drive rests, or its withdrawal has ended."""
        deadline_s = time.monotonic() + REST_WITHIN_S
        while (status := self.status()).fault is None and time.monotonic() < deadline_s:
            self.command(0.0)
            if not status.moving:
                break
            time.sleep(PERIOD_S)
        self.await_withdrawal()

    def _guarded(self, work: Callable[[int], None], now_ns: int) -> None:
        """Do a part of the work at the device; any exception is a fault."""
        try:
            work(now_ns)
        except DriveError as error:
            self._supervisor.mark_unsent(now_ns)
            self._supervisor.fail(self._fault_of(error, now_ns))
        except Exception as error:
            self._take_error(error, now_ns)

    def _take_error(self, error: BaseException, now_ns: int) -> None:
        self.counts[f"error: {type(error).__name__}"] += 1
        self._supervisor.mark_unsent(now_ns)
        self._supervisor.fail(internal_fault(self.part, self._thread_name, error, now_ns))

    def _fault_of(self, error: DriveError, now_ns: int) -> Fault:
        """Return the fault of a device's error."""
        kind = "fault" if error.kind is FaultKind.DRIVE_FAULT else error.kind.value
        return Fault(error.kind, self.part, f"{kind}: {error}", now_ns)

    @property
    def _thread_name(self) -> str:
        return f"{self.part.value} {type(self).__name__}"

    @abstractmethod
    def _connect(self) -> DriveDevice:
        """Open the drive's line. Raises DriveError."""

    @abstractmethod
    def _send(self, now_ns: int) -> None:
        """Send the velocity that the supervisor allows. Never waits for the drive in `command`."""

    @abstractmethod
    def _home_switch(self) -> bool | None:
        """Return whether the home switch is closed; None if it is not used or not reported."""

    def _read_reports(self, now_ns: int) -> None:  # noqa: B027
        """Check for silence, and pass the device's new reports to the supervisor."""

    def _step(self) -> None:
        """Do a step of the drive's own thread: read the reports, and send what the loop does not.

        A device that cannot be read is withdrawn all the same.
        """
        with self._lock.acquire_or_proceed():
            now_ns = time.perf_counter_ns()
            self._guarded(self._read_reports, now_ns)
            if self._sends_alone:
                self._guarded(self._send, now_ns)

    @property
    def _sends_alone(self) -> bool:
        """True while the drive's thread sends the velocity, in place of the loop: after a fault."""
        return self._supervisor.fault is not None

    def _follow(self, device: DriveDevice) -> None:
        """Start to send commands, and to check that they come."""
        now_ns = time.perf_counter_ns()
        self._supervisor.arm(now_ns)
        self._supervisor.add_position(device.position_m, now_ns)
        thread = GuardedThread(self._thread_name, self._run_once, self._on_error)
        thread.start()
        self._thread = thread

    def _run_once(self) -> None:
        self._woken.wait(self.step_s)
        self._woken.clear()
        self._step()

    def _on_error(self, error: BaseException) -> None:
        """Latch an exception of the drive's thread, which goes on to withdraw."""
        with self._lock.acquire_or_proceed():
            self._take_error(error, time.perf_counter_ns())

    def _pause(self) -> None:
        """Rest; the watchdog starts again with the next command."""
        with self._lock:
            self._supervisor.pause()

    def _move_to(self, position_m: float, guard: Callable[[], None] = lambda: None) -> None:
        """Move to within a step of a position by speed commands, and rest there; blocks.

        guard is called repeatedly, and may end the motion by raising. Raises DriveError.
        """
        speed_m_per_s, step_m = self._homing_speed, self._axis.units.step_m
        travel_m = abs(position_m - self.status().position_m)
        deadline_s = time.monotonic() + 2.0 + 2 * travel_m / speed_m_per_s
        deadline_s += math.log(max(travel_m / step_m, 1.0))
        sent_m_per_s = 0.0
        while True:
            guard()
            status = self.status()
            if status.fault is not None:
                fault = status.fault
                raise DriveError(fault.kind, f"on its way to first touch: {fault.cause}")
            # On a busy host or bus the report is old, and the tip has moved since.
            age_s = (time.perf_counter_ns() - status.received_ns) * 1e-9
            left_m = position_m - status.position_m - sent_m_per_s * age_s
            if abs(left_m) <= step_m:
                size = 0.0
            else:
                size = min(speed_m_per_s, max(abs(left_m) / TIME_CONSTANT_S, 10 * step_m))
            sent_m_per_s = math.copysign(size, left_m)
            self.command(sent_m_per_s)
            if not size and not status.moving:
                return
            if time.monotonic() > deadline_s:
                text = f"the tip stays {left_m * 1e3:.3f} mm before first touch"
                raise DriveError(FaultKind.NOT_THERE, text)
            time.sleep(PERIOD_S)
