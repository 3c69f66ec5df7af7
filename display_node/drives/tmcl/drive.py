"""A stepper module that speaks TMCL, in velocity mode.

TMCL answers every request, which takes 1.6 ms at 115200 baud. So a thread of the drive exchanges
messages with the module, and the force loop leaves its latest command in a mailbox (decision 19).
"""

import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from itertools import cycle

from display_node.drives.axis import Axis
from display_node.drives.drive import DriveStatus, no_film
from display_node.drives.homing import TouchGuard, approach_touch, undo_wrong_way
from display_node.drives.scene import TmclScene
from display_node.drives.supervisor import PassableLock, Supervisor
from display_node.drives.tmcl.module import TRANSIENT, TmclModule
from display_node.drives.tmcl.parameters import Parameter
from protocol.errors import DriveError

# Axis parameters that are read in turn: one at least every POLL_NS, more where the line has time.
POLLED = (
    Parameter.ACTUAL_POSITION,
    Parameter.ERROR_FLAGS,
    Parameter.ACTUAL_SPEED,
    Parameter.DRIVER_FLAGS,
)
POLL_NS = 10_000_000
REST_WITHIN_S = 1.0
REST_POLL_S = 0.002
# Between two attempts on a line that is gone.
RETRY_S = 0.02
# An answer names its command, not its axis parameter: so long after a missed one a position may be
# the late answer about another parameter. A withdrawal does not use it.
AMBIGUOUS_NS = 200_000_000


class TmclDrive:
    """See `Drive`. counts: as of `TmclLine`, and commands that a newer one "superseded"."""

    def __init__(self, scene: TmclScene, axis: Axis) -> None:
        self._scene = scene
        self._axis = axis
        self._module: TmclModule | None = None
        self._thread: threading.Thread | None = None
        self._woken = threading.Event()
        self._closing = False
        self._supervisor = Supervisor(axis, scene.watchdog_ns)
        # Of the supervisor, between the loop's thread and the drive's own.
        self._lock = PassableLock()
        self._taken_ns = self._missed_ns = 0
        self.counts: Counter[str] = Counter()

    def start(self, force_n: Callable[[], float | None] = no_film) -> None:
        """See `Drive.start`."""
        self.close()
        self._module = module = TmclModule(self._scene, self._axis)
        module.counts.update(self.counts)
        self.counts = module.counts
        guard = TouchGuard(force_n)
        axis, speed = self._axis, self._scene.homing_speed_m_per_s
        with undo_wrong_way(self, axis, speed, partial(self._resume_commands, module)) as begin:
            module.configure()
            module.read(Parameter.ACTUAL_POSITION)
            begin.began_m = module.position_m
            module.home(guard)
            begin.began_m = module.position_m
            module.arm_watchdog()
            self._start_commands(module)
            approach_touch(self, axis, speed, self._home_switch, guard)
        with self._lock:
            self._supervisor.verified = True
            self._supervisor.pause()

    def command(self, speed_m_per_s: float) -> None:
        """See `Drive.command`."""
        supervisor = self._supervisor
        if supervisor.fault is not None:
            return
        with self._lock:
            if supervisor.commanded_ns > self._taken_ns:
                self.counts["superseded"] += 1
            supervisor.command(speed_m_per_s, time.monotonic_ns())
        self._woken.set()

    def report_film(self, force_n: float, taken_ns: int) -> None:
        """See `Drive.press`."""
        with self._lock:
            self._supervisor.report_film(force_n, taken_ns)

    def status(self) -> DriveStatus:
        """See `Drive.status`."""
        module = self._module
        with self._lock:
            return self._supervisor.status(0.0 if module is None else module.speed_m_per_s)

    def travel_m(self, now_ns: int) -> float:
        """See `Drive.travel_m`."""
        with self._lock:
            return self._supervisor.travel_m(now_ns)

    def withdraw(self, reason: str) -> None:
        """See `Drive.withdraw`."""
        with self._lock:
            self._supervisor.fail(reason, time.monotonic_ns())
        self._woken.set()

    def close(self) -> None:
        """See `Drive.close`."""
        if self._thread is not None:
            with self._lock:
                self._supervisor.command(0.0, time.monotonic_ns())
            deadline_s = time.monotonic() + REST_WITHIN_S
            while self._moves() and time.monotonic() < deadline_s:
                time.sleep(REST_POLL_S)
            self._closing = True
            self._woken.set()
            self._thread.join()
            self._thread = None
        self._supervisor.end("closed")
        if self._module is not None:
            self._module.halt()
            self._module.close()
            self._module = None

    def _moves(self) -> bool:
        status = self.status()
        return status.fault is None and status.moving

    def _start_commands(self, module: TmclModule) -> None:
        """Begin to send commands."""
        now_ns = time.monotonic_ns()
        self._supervisor.arm(now_ns)
        self._supervisor.report(module.position_m, now_ns)
        self._taken_ns = self._missed_ns = 0
        self._closing = False
        self._thread = threading.Thread(target=self._run, args=(module,), daemon=True)
        self._thread.start()

    def _resume_commands(self, module: TmclModule) -> None:
        """End a search for home and begin to send commands."""
        if self._thread is None:
            module.halt()
            self._start_commands(module)

    def _home_switch(self) -> bool | None:
        """Return whether the home switch is closed; None where home is not by it."""
        module = self._module
        if module is None or self._scene.homing != "switch" or self._scene.homing_method:
            return None
        requested_ns, module.switch_requested = time.monotonic_ns(), True
        deadline_s = time.monotonic() + REST_WITHIN_S
        while module.switch_ns < requested_ns and time.monotonic() < deadline_s:
            self.command(0.0)
            time.sleep(REST_POLL_S)
        module.switch_requested = False
        if module.switch_ns < requested_ns:
            raise DriveError("no answer", "the module does not report its home switch")
        return module.switch_closed

    def _run(self, module: TmclModule) -> None:
        parameters = cycle(POLLED)
        requested_ns = 0
        while not self._closing:
            self._woken.wait(self._scene.period_ns * 1e-9)
            self._woken.clear()
            now_ns = time.monotonic_ns()
            try:
                # A command between any two reads: an answer that comes far too late names its
                # command, and so is never taken for the answer to another read.
                self._send(module, now_ns)
                if not self._woken.is_set() or now_ns - requested_ns >= POLL_NS:
                    requested_ns = now_ns
                    parameter = next(parameters)
                    module.read(module.switch if module.switch_requested else parameter)
            except DriveError as error:
                self._fail(module, error)
            self._report(module)

    def _send(self, module: TmclModule, now_ns: int) -> None:
        """Send the present velocity, however old the command is: that feeds the heartbeat."""
        with self._lock.passing():
            supervisor = self._supervisor
            supervisor.check_silence(now_ns)
            self._taken_ns = supervisor.commanded_ns
            velocity = supervisor.velocity(now_ns)
            supervisor.sent(velocity, now_ns)
        module.rotate(velocity)

    def _report(self, module: TmclModule) -> None:
        with self._lock.passing():
            supervisor = self._supervisor
            supervisor.answered(module.received_ns)
            if supervisor.fault and module.position_ns - self._missed_ns < AMBIGUOUS_NS:
                return
            if module.position_ns > supervisor.position_ns:
                supervisor.report(module.position_m, module.position_ns)

    def _fail(self, module: TmclModule, error: DriveError) -> None:
        """Latch an error that the next request cannot make good; the withdrawal goes on.

        A module that obeys without an answer is thus commanded on, to its home switch.
        """
        now_ns = time.monotonic_ns()
        with self._lock.passing():
            self._supervisor.mark_unsent(now_ns)
            if error.kind in TRANSIENT:
                self._missed_ns = now_ns
                if now_ns - module.received_ns <= self._scene.watchdog_ns:
                    return
            self._supervisor.fail(f"{error.kind}: {error}", now_ns)
        if error.kind not in (*TRANSIENT, "fault"):
            time.sleep(RETRY_S)
