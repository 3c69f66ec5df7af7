"""A CANopen drive of profile CiA 402, in cyclic synchronous or profile velocity.

A command is one RPDO, and a SYNC that makes it count; neither waits for the drive. Our heartbeat
goes out with the commands and with nothing else: the drive rests when they stop, whether this
process has died or only hangs.
"""

import time
from collections import Counter

from display_node.drives.approach import approach
from display_node.drives.axis import Axis
from display_node.drives.cia402_node import POLL_S, Cia402Node
from display_node.drives.cia402_states import (
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
from display_node.drives.drive import DriveStatus
from display_node.drives.scene import Cia402Scene
from display_node.drives.told_way import ToldWay
from display_node.step_rate import AT_REST, StepCommand
from protocol.errors import DriveError

ENABLE_WITHIN_S = 2.0
REST_WITHIN_S = 1.0
# Heartbeats in the time after which the drive misses them.
BEATS = 4


class Cia402Drive:
    """See `Drive`. counts: as of `Cia402Node`."""

    def __init__(self, scene: Cia402Scene, axis: Axis) -> None:
        self._scene = scene
        self._axis = axis
        self._node: Cia402Node | None = None
        self._fault: str | None = "not started"
        self._beat_ns = 0
        self._way = ToldWay()
        self.counts: Counter[str] = Counter()

    def start(self) -> None:
        """See `Drive.start`."""
        self.close()
        self._node = node = Cia402Node(self._scene, self._axis, self.counts)
        try:
            node.configure()
            node.select_velocity()
            self._enable(node)
            self._home(node)
            node.limit_travel()
            node.arm()
            self._fault = None
            approach(self, 0.0, self._scene.homing_speed_m_per_s, self._axis.units.step_m)
            # Supervised again from the force loop's first command on, by a heartbeat with it.
            node.arm()
            self._beat_ns = 0
        except BaseException:  # Ctrl-C, too, must not leave it moving.
            self.close()
            raise

    def command(self, command: StepCommand) -> None:
        """See `Drive.command`."""
        node, now_ns = self._node, time.monotonic_ns()
        if node is None or self._watch(node, now_ns) is not None:
            return
        velocity = self._axis.velocity(command, node.position_m, now_ns - node.heard_ns)
        try:
            told_ns = node.tell(Control.ENABLE, velocity)
            self._way.tell(self._axis.units.speed_m_per_s(velocity), told_ns)
            if now_ns - self._beat_ns >= self._scene.watchdog_ns // BEATS:
                self._beat_ns = now_ns
                node.beat()
        except DriveError as error:
            self._fault = f"{error.kind}: {error}"

    def status(self) -> DriveStatus:
        """See `Drive.status`."""
        node = self._node
        if node is None:
            return DriveStatus(self._axis.lowest_m, 0.0, self._fault, False, 0)
        speed = node.speed_m_per_s
        fault = self._watch(node, time.monotonic_ns())
        held_back = self._axis.travel.held_back
        return DriveStatus(node.position_m, speed, fault, speed != 0, node.heard_ns, held_back)

    def way_m(self, now_ns: int) -> float:
        """See `Drive.way_m`."""
        return self._way.way_m(now_ns)

    def stop(self) -> None:
        """See `Drive.stop`."""
        if self._fault is None:
            self._fail("stopped")

    def close(self) -> None:
        """See `Drive.close`."""
        node = self._node
        if node is None:
            return
        deadline_s = time.monotonic() + REST_WITHIN_S
        while self.status().fault is None and time.monotonic() < deadline_s:
            self.command(AT_REST)
            if not node.speed_m_per_s:
                break
            time.sleep(POLL_S)
        self._fault = self._fault or "closed"
        self._let_go(node)
        self._node = None

    def _watch(self, node: Cia402Node, now_ns: int) -> str | None:
        """The fault, if there is one by now."""
        if self._fault is not None:
            return self._fault
        state, silent_ns = node.state, now_ns - node.heard_ns
        if state in (State.FAULT, State.REACTING):
            self._fail(f"fault: {node.error}")
        elif state is not State.ENABLED:
            self._fail(f"fault: {state.text}, {node.error}")
        elif silent_ns > self._scene.watchdog_ns:
            self._fail(f"no answer: for {silent_ns / 1e6:.0f} ms")
        return self._fault

    def _fail(self, fault: str) -> None:
        """Latch a fault, and stop the drive if it still hears us."""
        self._fault = fault
        if self._node is not None:
            try:
                self._node.tell(Control.QUICK_STOP, 0)
            except DriveError as error:
                self._fault = f"{fault}; {error.kind}: {error}"

    def _let_go(self, node: Cia402Node) -> None:
        """Disable the drive; what does not reach it any more is its watchdog's."""
        try:
            node.tell(Control.SHUTDOWN, 0)
            node.tell(Control.DISABLE_VOLTAGE, 0)
            node.disarm()
        except DriveError as error:
            self._fault = f"{self._fault}; {error.kind}: {error}"
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

    def _home(self, node: Cia402Node) -> None:
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
        began_ns = time.monotonic_ns()
        while node.heard_ns < began_ns or node.statusword & HOMING_ATTAINED != HOMING_ATTAINED:
            if node.state is not State.ENABLED:
                raise DriveError("not homed", f"{node.state.text} on its way home, {node.error}")
            if node.statusword & HOMING_ERROR:
                raise DriveError("not homed", f"homing method {method} fails")
            if time.monotonic() > deadline_s:
                raise DriveError("not homed", f"no home within {axis.search_s:.0f} s")
            time.sleep(POLL_S)
        node.tell(Control.ENABLE, 0)
        node.select_velocity()
