"""A CANopen drive of profile CiA 402, in cyclic synchronous or profile velocity.

A command is one RPDO, and a SYNC that makes it count; neither waits for the drive. Our heartbeat
goes out with the commands and with nothing else: the drive rests when they stop, whether this
process has died or only hangs. After a fault a thread of our own takes the tip off the finger.
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
    undone_where_wrong,
)
from display_node.drives.scene import Cia402Scene
from display_node.drives.supervisor import PassableLock, Supervisor
from protocol.errors import DriveError

ENABLE_WITHIN_S = 2.0
REST_WITHIN_S = 1.0
# Heartbeats in the time after which the drive misses them.
BEATS = 4
# Our own thread's look at commands and answers; a withdrawal's commands.
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
        # Of the supervisor and of what is sent, by the loop's thread and by ours.
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
        with undone_where_wrong(self, axis, speed, partial(self._follow_again, node)) as way:
            node.configure()
            node.select_velocity()
            self._enable(node)
            way.began_m = node.position_m
            self._home(node, guard)
            way.began_m = node.position_m
            node.limit_travel()
            node.arm()
            self._follow(node)
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
            self._judge(node, now_ns)
            supervisor.command(speed_m_per_s, now_ns)
            self._send(node, now_ns)

    def press(self, force_n: float, taken_ns: int) -> None:
        """See `Drive.press`."""
        with self._lock:
            self._supervisor.press(force_n, taken_ns)

    def status(self) -> DriveStatus:
        """See `Drive.status`."""
        node = self._node
        with self._lock:
            if node is None:
                return self._supervisor.status(0.0)
            self._judge(node, time.monotonic_ns())
            return self._supervisor.status(node.speed_m_per_s)

    def way_m(self, now_ns: int) -> float:
        """See `Drive.way_m`."""
        with self._lock:
            return self._supervisor.way_m(now_ns)

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
        self._let_go(node)
        self._node = None

    def _follow(self, node: Cia402Node) -> None:
        """Begin to pass commands on, and to watch that they come."""
        self._supervisor.arm(time.monotonic_ns())
        self._control = Control.ENABLE
        self._ending.clear()
        self._thread = threading.Thread(target=self._run, args=(node,), daemon=True)
        self._thread.start()

    def _pause(self, node: Cia402Node) -> None:
        """Rest, and have neither side expect commands or heartbeats before the next command."""
        with self._lock:
            self._supervisor.pause()
            self._beat_ns = 0
        node.arm()

    def _follow_again(self, node: Cia402Node) -> None:
        """End the search for home, if that is what the drive does, and pass commands on."""
        if self._thread is None:
            node.tell(Control.ENABLE, 0)
            node.select_velocity()
            self._follow(node)

    def _run(self, node: Cia402Node) -> None:
        """Withdraw where the loop's thread cannot: it may hang, and a fault needs no tick."""
        while not self._ending.wait(WATCH_S):
            with self._lock.passing():
                now_ns = time.monotonic_ns()
                self._judge(node, now_ns)
                if self._supervisor.withdrawal is not None:
                    self._send(node, now_ns)

    def _judge(self, node: Cia402Node, now_ns: int) -> None:
        """Pass on what the drive reported, and latch its fault where it has one."""
        supervisor = self._supervisor
        supervisor.watch(now_ns, node.silence)
        # Its TPDO brings the position and the state.
        if node.heard_ns > supervisor.position_ns:
            supervisor.report(node.position_m, node.heard_ns)
        state = node.state
        if state in (State.FAULT, State.REACTING):
            supervisor.fail(f"fault: {node.error}", now_ns)
        elif state is not State.ENABLED:
            supervisor.fail(f"fault: {state.text}, {node.error}", now_ns)

    def _send(self, node: Cia402Node, now_ns: int) -> None:
        """Send the velocity of now; a drive that is not enabled is led back to it first."""
        supervisor, enabled = self._supervisor, node.state is State.ENABLED
        velocity = supervisor.velocity(now_ns) if enabled else 0
        self._control = Control.ENABLE if enabled else towards_enabled(node.state, self._control)
        try:
            sent_ns = node.tell(self._control, velocity)
            supervisor.sent(velocity, sent_ns)
            if now_ns - self._beat_ns >= self._scene.watchdog_ns // BEATS:
                self._beat_ns = now_ns
                node.beat()
        except DriveError as error:
            supervisor.fail(f"{error.kind}: {error}", now_ns)

    def _home_switch(self, node: Cia402Node) -> bool | None:
        """Return whether the home switch is closed; None where it is not what home is by, or the
        drive does not report its inputs."""
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

    def _let_go(self, node: Cia402Node) -> None:
        """Disable the drive; what does not reach it any more is its watchdog's."""
        try:
            node.tell(Control.SHUTDOWN, 0)
            node.tell(Control.DISABLE_VOLTAGE, 0)
            node.disarm()
        except DriveError as error:
            self.counts[f"not let go: {error.kind}"] += 1
        node.close()

    def _enable(self, node: Cia402Node) -> None:
        control = Control.DISABLE_VOLTAGE
        deadline_s = time.monotonic() + ENABLE_WITHIN_S
        while not node.heard_ns or node.state is not State.ENABLED:
            if time.monotonic() > deadline_s:
                heard = node.state.text if node.heard_ns else "it sends no TPDO"
                raise DriveError("not enabled", f"still {heard}, {node.error}")
            control = towards_enabled(node.state, control)
            node.tell(control, 0)
            time.sleep(POLL_S)

    def _home(self, node: Cia402Node, guard: Callable[[], None]) -> None:
        scene, axis = self._scene, self._axis
        switch = POSITIVE_SWITCH if scene.inverted else NEGATIVE_SWITCH
        method = scene.homing_method
        if method is None:
            method = switch if scene.homing == "switch" else HERE
        speed = abs(axis.units.velocity(scene.homing_speed_m_per_s))
        node.write(0x6098, 0, method)
        node.write_if_there(0x6099, 1, speed)
        node.write_if_there(0x6099, 2, max(1, speed // 4))
        per_second = scene.velocity_scale / axis.units.step_m
        node.write_if_there(0x609A, 0, round(axis.max_acceleration_m_per_s2 * per_second))
        node.select(Mode.HOMING)
        node.tell(Control.ENABLE, 0)
        node.tell(Control.START_HOMING, 0)
        deadline_s = time.monotonic() + axis.search_s
        began_ns, bound = time.monotonic_ns(), SearchBound(axis, node.position_m)
        while node.heard_ns < began_ns or node.statusword & HOMING_ATTAINED != HOMING_ATTAINED:
            guard()
            bound(node.position_m)
            if node.state is not State.ENABLED:
                raise DriveError("not homed", f"{node.state.text} on its way home, {node.error}")
            if node.statusword & HOMING_ERROR:
                raise DriveError("not homed", f"homing method {method} fails")
            if time.monotonic() > deadline_s:
                raise DriveError("not homed", f"no home within {axis.search_s:.0f} s")
            time.sleep(POLL_S)
        node.tell(Control.ENABLE, 0)
        node.select_velocity()
