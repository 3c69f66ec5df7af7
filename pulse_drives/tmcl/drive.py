"""A TMCL stepper module in velocity mode.

A TMCL request and its answer take 1.6 ms at 115200 baud. So a thread of the drive exchanges
messages with the module, and the force loop only stores its latest command (decision 19).
"""

import time
from itertools import cycle

from protocol.errors import DriveError, SceneError
from protocol.faults import FaultKind
from pulse_drives.axis import Axis
from pulse_drives.drive import PERIOD_S, REST_WITHIN_S, Drive, DriveDevice
from pulse_drives.scene import TmclScene
from pulse_drives.tmcl.module import TRANSIENT, Parameter, TmclModule

# Axis parameters that are read in turn: one in each period of the thread in which no new command
# waits, and at least one in POLL_NS.
POLLED = (
    Parameter.ACTUAL_POSITION,
    Parameter.ERROR_FLAGS,
    Parameter.ACTUAL_SPEED,
    Parameter.DRIVER_FLAGS,
)
POLL_NS = 10_000_000
# Pause between two attempts while the line is disconnected.
RETRY_S = 0.02
# An answer contains the number of its command, not the axis parameter. After a missed answer, a
# position may be the late answer about another parameter. A withdrawal ignores it for this time.
AMBIGUOUS_NS = 200_000_000


class TmclDrive(Drive):
    """A `Drive` over TMCL. counts: those of `TmclLine`, and "superseded" for commands not sent.

    Raises SceneError for a number of microsteps that no TMCL module has.
    """

    _module: TmclModule

    def __init__(self, scene: TmclScene, axis: Axis) -> None:
        super().__init__(scene, axis)
        if axis.microsteps.bit_count() != 1:
            raise SceneError(
                f"actuator.microsteps: a TMCL module has 1, 2, 4, to 256, got {axis.microsteps}"
            )
        self._scene = scene
        self.step_s = scene.period_ns * 1e-9

    def command(self, speed_m_per_s: float) -> None:
        """See `Drive.command`: the drive's thread sends it, since an exchange takes 1.6 ms."""
        supervisor = self._supervisor
        if supervisor.fault is not None:
            return
        with self._lock:
            if supervisor.commanded_ns > self._taken_ns:
                self.counts["superseded"] += 1
            supervisor.set_target(speed_m_per_s, time.perf_counter_ns())
        self._woken.set()

    def _connect(self) -> DriveDevice:
        self._module = TmclModule(self._scene, self._axis, self.counts)
        self._parameters = cycle(POLLED)
        self._requested_ns = self._taken_ns = self._missed_ns = 0
        return self._module

    def _home_switch(self) -> bool | None:
        module = self._module
        if self._scene.homing != "switch" or self._scene.homing_method:
            return None
        requested_ns, module.switch_requested = time.perf_counter_ns(), True
        deadline_s = time.monotonic() + REST_WITHIN_S
        while module.switch_ns < requested_ns and time.monotonic() < deadline_s:
            self.command(0.0)
            time.sleep(PERIOD_S)
        module.switch_requested = False
        if module.switch_ns < requested_ns:
            raise DriveError(FaultKind.NO_ANSWER, "the module does not report its home switch")
        return module.switch_closed

    def _step(self) -> None:
        module, now_ns = self._module, time.perf_counter_ns()
        try:
            # A rotate command separates any two reads. So an answer that is late by a whole request
            # meets a request with another command number, and is ignored.
            self._send(now_ns)
            if not self._woken.is_set() or now_ns - self._requested_ns >= POLL_NS:
                self._requested_ns = now_ns
                parameter = next(self._parameters)
                module.read(module.switch if module.switch_requested else parameter)
        except DriveError as error:
            self._fail(error)
        with self._lock.acquire_or_proceed():
            supervisor = self._supervisor
            supervisor.answered_ns = module.received_ns
            if supervisor.fault and module.position_ns - self._missed_ns < AMBIGUOUS_NS:
                return
            if module.position_ns > supervisor.position_ns:
                supervisor.add_position(module.position_m, module.position_ns)

    def _send(self, now_ns: int) -> None:
        """Send the velocity, new or not, so that the module's watchdog does not stop the motor."""
        with self._lock.acquire_or_proceed():
            supervisor = self._supervisor
            supervisor.check_silence(now_ns)
            self._taken_ns = supervisor.commanded_ns
            velocity = supervisor.velocity_to_send(now_ns)
            supervisor.mark_sent(velocity, now_ns)
        self._module.rotate(velocity)

    def _fail(self, error: DriveError) -> None:
        """Latch an error, unless it is transient and the module has answered recently.

        The withdrawal continues in either case, as the module may execute commands without
        answering.
        """
        now_ns = time.perf_counter_ns()
        with self._lock.acquire_or_proceed():
            self._supervisor.mark_unsent(now_ns)
            if error.kind in TRANSIENT:
                self._missed_ns = now_ns
                if now_ns - self._module.received_ns <= self._scene.watchdog_ns:
                    return
            self._supervisor.fail(self._fault_of(error, now_ns))
        if error.kind not in (*TRANSIENT, FaultKind.DRIVE_FAULT):
            time.sleep(RETRY_S)
