"""A stepper module that speaks TMCL, in velocity mode.

TMCL answers every request, and the answer takes as long as the line does: 1.6 ms there and back
at 115200 baud. So a thread of its own talks to the module, and the force loop leaves the latest
command in a mailbox.
"""

import threading
import time
from collections import Counter
from itertools import cycle

from display_node.drives.approach import approach
from display_node.drives.axis import Axis
from display_node.drives.drive import DriveStatus
from display_node.drives.scene import TmclScene
from display_node.drives.tmcl_module import PASSING, TmclModule
from display_node.drives.tmcl_numbers import Parameter
from display_node.drives.told_way import ToldWay
from display_node.step_rate import AT_REST, StepCommand
from protocol.errors import DriveError

# What is asked in turn, one a slot: so often at least, more often where the line has time.
QUESTIONS = (
    Parameter.ACTUAL_POSITION,
    Parameter.ERROR_FLAGS,
    Parameter.ACTUAL_SPEED,
    Parameter.DRIVER_FLAGS,
)
QUESTION_NS = 10_000_000
REST_WITHIN_S = 1.0
REST_POLL_S = 0.002


class TmclDrive:
    """See `Drive`. counts: as of `TmclLine`, and commands that a newer one "superseded"."""

    def __init__(self, scene: TmclScene, axis: Axis) -> None:
        self._scene = scene
        self._axis = axis
        self._module: TmclModule | None = None
        self._thread: threading.Thread | None = None
        self._woken = threading.Event()
        self._fault: str | None = "not started"
        # The mailbox: the command and when it was given; 0 before the first.
        self._told = (AT_REST, 0)
        self._taken_ns = 0
        self._way = ToldWay()
        self.counts: Counter[str] = Counter()

    def start(self) -> None:
        """See `Drive.start`."""
        self.close()
        self._module = module = TmclModule(self._scene, self._axis)
        module.counts.update(self.counts)
        self.counts = module.counts
        try:
            module.configure()
            module.home()
            module.arm()
            self._told, self._taken_ns, self._fault = (AT_REST, 0), 0, None
            self._thread = threading.Thread(target=self._run, args=(module,), daemon=True)
            self._thread.start()
            approach(self, 0.0, self._scene.homing_speed_m_per_s, self._axis.units.step_m)
        except BaseException:  # Ctrl-C, too, must not leave it moving.
            self.close()
            raise
        # Supervised again from the force loop's first command on.
        self._told = (AT_REST, 0)

    def command(self, command: StepCommand) -> None:
        """See `Drive.command`."""
        if self._fault is not None:
            return
        if self._told[1] > self._taken_ns:
            self.counts["superseded"] += 1
        self._told = (command, time.monotonic_ns())
        self._woken.set()

    def status(self) -> DriveStatus:
        """See `Drive.status`."""
        module = self._module
        if module is None:
            return DriveStatus(self._axis.lowest_m, 0.0, self._fault, False, 0)
        speed = module.speed_m_per_s
        fault, heard_ns = self._fault, module.position_ns
        held_back = self._axis.travel.held_back
        return DriveStatus(module.position_m, speed, fault, speed != 0, heard_ns, held_back)

    def way_m(self, now_ns: int) -> float:
        """See `Drive.way_m`."""
        return self._way.way_m(now_ns)

    def stop(self) -> None:
        """See `Drive.stop`."""
        self._fault = self._fault or "stopped"
        self._woken.set()

    def close(self) -> None:
        """See `Drive.close`."""
        if self._thread is not None:
            self._told = (AT_REST, 0)
            deadline_s = time.monotonic() + REST_WITHIN_S
            while self._fault is None and self.status().moving and time.monotonic() < deadline_s:
                time.sleep(REST_POLL_S)
            self._fault = self._fault or "closed"
            self._woken.set()
            self._thread.join()
            self._thread = None
        if self._module is not None:
            self._module.halt()
            self._module.close()
            self._module = None

    def _run(self, module: TmclModule) -> None:
        questions = cycle(QUESTIONS)
        asked_ns = 0
        while True:
            self._woken.wait(self._scene.period_ns * 1e-9)
            self._woken.clear()
            if self._fault is not None:
                break
            now_ns = time.monotonic_ns()
            try:
                # A command between any two questions: an answer that comes far too late names
                # its command, and so is never taken for the answer to another question.
                self._tell(module, now_ns)
                if not self._woken.is_set() or now_ns - asked_ns >= QUESTION_NS:
                    asked_ns = now_ns
                    module.hear(next(questions))
            except DriveError as error:
                silent_ns = time.monotonic_ns() - module.heard_ns
                if error.kind not in PASSING or silent_ns > self._scene.watchdog_ns:
                    self._fault = self._fault or f"{error.kind}: {error}"
        module.halt()

    def _tell(self, module: TmclModule, now_ns: int) -> None:
        """Pass the latest command on, however old it is: that keeps the module's heartbeat."""
        command, told_ns = self._told
        self._taken_ns = told_ns
        if told_ns and now_ns - told_ns > self._scene.watchdog_ns:
            silent_ms = (now_ns - told_ns) / 1e6
            raise DriveError("no command", f"for {silent_ms:.0f} ms")
        age_ns = now_ns - module.position_ns
        velocity = self._axis.velocity(command, module.position_m, age_ns)
        self._way.tell(self._axis.units.speed_m_per_s(velocity), now_ns)
        module.rotate(velocity)
