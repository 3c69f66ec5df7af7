"""A CANopen drive of profile CiA 402, in cyclic synchronous or profile velocity mode.

A command is one RPDO and the SYNC by which it takes effect; neither waits for the drive. Our
heartbeat is sent with the commands and with nothing else: the drive stops when they stop, whether
this process has died or only hangs. After a fault a thread withdraws the tip (decisions 19, 29).
Decision 32 says why canopen's `BaseNode402` does not suffice.
"""

import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial

from display_node.drives.axis import Axis
from display_node.drives.cia402.node import POLL_S, Cia402Node
from display_node.drives.cia402.state_machine import (
    HERE,
    HOMING_ATTAINED,
    HOMING_ERROR,
    NEGATIVE_SWITCH,
    POSITIVE_SWITCH,
    Control,
    Mode,
    State,
    towards_enabled,
)
from display_node.drives.drive import DriveStatus, no_film
from display_node.drives.homing import (
    SearchBound,
    TouchGuard,
    approach_touch,
    undo_wrong_way,
)
from display_node.drives.scene import Cia402Scene
from display_node.drives.supervisor import PassableLock, Supervisor
from protocol.errors import DriveError

ENABLE_WITHIN_S = 2.0
REST_WITHIN_S = 1.0
# Heartbeats in the drive's watchdog time.
BEATS = 4
# Period of the thread that checks commands and answers, and commands a withdrawal.
WATCH_S = 5e-3
# Object of the digital inputs, and its bits for the limit switches.
DIGITAL_INPUTS, NEGATIVE_INPUT, POSITIVE_INPUT = 0x60FD, 1, 2


class Cia402Drive:
    """See `Drive`. counts: as of `Cia402Node`."""

    def __init__(self, scene: Cia402Scene, axis: Axis) -> None:
        self._scene = scene
        self._axis = axis
        self._node: Cia402Node | None = None
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()
        self._supervisor = Supervisor(axis, scene.watchdog_ns)
        # Of the supervisor and of the commands, between the loop's thread and the drive's own.
        self._lock = PassableLock()
        self._control = Control.ENABLE
        self._beat_ns = 0
        self.counts: Counter[str] = Counter()

    def start(self, force_n: Callable[[], float | None] = no_film) -> None:
        """See `Drive.start`."""
        self.close()
        self._node = node = Cia402Node(self._scene, self._axis, self.counts)
        guard = TouchGuard(force_n)
        axis, speed = self._axis, self._scene.homing_speed_m_per_s
        with undo_wrong_way(self, axis, speed, partial(self._resume_commands, node)) as begin:
            node.configure()
            node.select_velocity()
            self._enable(node)
            begin.began_m = node.position_m
            self._home(node, guard)
            begin.began_m = node.position_m
            node.limit_travel()
            node.arm_watchdog()
            self._start_commands(node)
            approach_touch(self, axis, speed, partial(self._home_switch, node), guard)
            self._pause(node)
        self._supervisor.verified = True

    def command(self, speed_m_per_s: float) -> None:
        """See `Drive.command`."""
        node, supervisor = self._node, self._supervisor
        if node is None or supervisor.fault is not None:
            return
        with self._lock:
            now_ns = time.monotonic_ns()
            self._check(node, now_ns)
            supervisor.command(speed_m_per_s, now_ns)
            self._send(node, now_ns)

    def report_film(self, force_n: float, taken_ns: int) -> None:
        """See `Drive.press`."""
        with self._lock:
            self._supervisor.report_film(force_n, taken_ns)

    def status(self) -> DriveStatus:
        """See `Drive.status`."""
        node = self._node
        with self._lock:
            if node is None:
                return self._supervisor.status(0.0)
            self._check(node, time.monotonic_ns())
            return self._supervisor.status(node.speed_m_per_s)

    def travel_m(self, now_ns: int) -> float:
        """See `Drive.travel_m`."""
        with self._lock:
            return self._supervisor.travel_m(now_ns)

    def withdraw(self, reason: str) -> None:
        """See `Drive.withdraw`."""
        with self._lock:
            self._supervisor.fail(reason, time.monotonic_ns())

    def close(self) -> None:
        """See `Drive.close`."""
        node = self._node
        if node is None:
            return
        deadline_s = time.monotonic() + REST_WITHIN_S
        while self.status().fault is None and time.monotonic() < deadline_s:
            self.command(0.0)
            if not node.speed_m_per_s:
                break
            time.sleep(POLL_S)
        if self._thread is not None:
            self._ending.set()
            self._thread.join()
            self._thread = None
        self._supervisor.end("closed")
        self._disable(node)
        self._node = None

    def _start_commands(self, node: Cia402Node) -> None:
        """Begin to send commands, and to check that they come."""
        self._supervisor.arm(time.monotonic_ns())
        self._control = Control.ENABLE
        self._ending.clear()
        self._thread = threading.Thread(target=self._run, args=(node,), daemon=True)
        self._thread.start()

    def _pause(self, node: Cia402Node) -> None:
        """Rest; neither side expects commands or heartbeats before the next command."""
        with self._lock:
            self._supervisor.pause()
            self._beat_ns = 0
        node.arm_watchdog()

    def _resume_commands(self, node: Cia402Node) -> None:
        """End a search for home and begin to send commands."""
        if self._thread is None:
            node.command(Control.ENABLE, 0)
            node.select_velocity()
            self._start_commands(node)

    def _run(self, node: Cia402Node) -> None:
        """Withdraw in the drive's own thread: the loop may hang, and a fault needs no tick."""
        while not self._ending.wait(WATCH_S):
            with self._lock.passing():
                now_ns = time.monotonic_ns()
                self._check(node, now_ns)
                if self._supervisor.withdrawal is not None:
                    self._send(node, now_ns)

    def _check(self, node: Cia402Node, now_ns: int) -> None:
        """Hand the drive's reports to the supervisor, and latch the drive's fault, if any."""
        supervisor = self._supervisor
        supervisor.check_silence(now_ns, node.silence)
        # One TPDO has both position and state.
        if node.received_ns > supervisor.position_ns:
            supervisor.report(node.position_m, node.received_ns)
        state = node.state
        if state in (State.FAULT, State.REACTING):
            supervisor.fail(f"fault: {node.error}", now_ns)
        elif state is not State.ENABLED:
            supervisor.fail(f"fault: {state.text}, {node.error}", now_ns)

    def _send(self, node: Cia402Node, now_ns: int) -> None:
        """Send the present velocity; a drive that is not enabled is enabled again first."""
        supervisor, enabled = self._supervisor, node.state is State.ENABLED
        velocity = supervisor.velocity(now_ns) if enabled else 0
        self._control = Control.ENABLE if enabled else towards_enabled(node.state, self._control)
        try:
            sent_ns = node.command(self._control, velocity)
            supervisor.sent(velocity, sent_ns)
            if now_ns - self._beat_ns >= self._scene.watchdog_ns // BEATS:
                self._beat_ns = now_ns
                node.send_heartbeat()
        except DriveError as error:
            supervisor.fail(f"{error.kind}: {error}", now_ns)

    def _home_switch(self, node: Cia402Node) -> bool | None:
        """Return whether the home switch is closed; None where home is not by it or unreported."""
        if self._scene.homing != "switch" or self._scene.homing_method is not None:
            return None
        # Reading it takes longer than the watchdog allows between two commands.
        self._pause(node)
        try:
            inputs = node.read(DIGITAL_INPUTS)
        except DriveError as error:
            if error.kind != "refused":
                raise
            return None
        return bool(inputs & (POSITIVE_INPUT if self._scene.inverted else NEGATIVE_INPUT))

    def _disable(self, node: Cia402Node) -> None:
        """Disable the drive; where it is not reached any more, its watchdog stops it."""
        try:
            node.command(Control.SHUTDOWN, 0)
            node.command(Control.DISABLE_VOLTAGE, 0)
            node.disarm_watchdog()
        except DriveError as error:
            self.counts[f"not disabled: {error.kind}"] += 1
        node.close()

    def _enable(self, node: Cia402Node) -> None:
        control = Control.DISABLE_VOLTAGE
        deadline_s = time.monotonic() + ENABLE_WITHIN_S
        while not node.received_ns or node.state is not State.ENABLED:
            if time.monotonic() > deadline_s:
                state = node.state.text if node.received_ns else "it sends no TPDO"
                raise DriveError("not enabled", f"still {state}, {node.error}")
            control = towards_enabled(node.state, control)
            node.command(control, 0)
            time.sleep(POLL_S)

    def _home(self, node: Cia402Node, guard: Callable[[], None]) -> None:
        scene, axis = self._scene, self._axis
        switch = POSITIVE_SWITCH if scene.inverted else NEGATIVE_SWITCH
        method = scene.homing_method
        if method is None:
            method = switch if scene.homing == "switch" else HERE
        speed = abs(axis.units.velocity(scene.homing_speed_m_per_s))
        node.write(0x6098, 0, method)
        node.write_optional(0x6099, 1, speed)
        node.write_optional(0x6099, 2, max(1, speed // 4))
        per_second = scene.velocity_scale / axis.units.step_m
        node.write_optional(0x609A, 0, round(axis.max_acceleration_m_per_s2 * per_second))
        node.select(Mode.HOMING)
        node.command(Control.ENABLE, 0)
        node.command(Control.START_HOMING, 0)
        deadline_s = time.monotonic() + axis.search_s
        began_ns, bound = time.monotonic_ns(), SearchBound(axis, node.position_m)
        while node.received_ns < began_ns or node.statusword & HOMING_ATTAINED != HOMING_ATTAINED:
            guard()
            bound(node.position_m)
            if node.state is not State.ENABLED:
                raise DriveError("not homed", f"{node.state.text} on its way home, {node.error}")
            if node.statusword & HOMING_ERROR:
                raise DriveError("not homed", f"homing method {method} fails")
            if time.monotonic() > deadline_s:
                raise DriveError("not homed", f"no home within {axis.search_s:.0f} s")
            time.sleep(POLL_S)
        node.command(Control.ENABLE, 0)
        node.select_velocity()
