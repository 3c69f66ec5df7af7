"""A CANopen drive of profile CiA 402, in cyclic synchronous or profile velocity mode.

A command is one RPDO (process data to the drive), and the SYNC at which it takes effect; neither
waits for the drive. Our heartbeat is sent only with commands. So the drive stops when commands
stop, whether this process has ended or hangs. After a fault a thread withdraws the tip (decisions
19, 29). Decision 32 explains why canopen's `BaseNode402` does not suffice.
"""

from protocol.errors import DriveError
from protocol.faults import FaultKind
from pulse_drives.axis import Axis
from pulse_drives.cia402.node import BEATS, Cia402Node
from pulse_drives.cia402.state_machine import Controlword, State, towards_enabled
from pulse_drives.drive import Drive, DriveDevice
from pulse_drives.scene import Cia402Scene

# Object of the digital inputs, and its bits for the limit switches.
DIGITAL_INPUTS, NEGATIVE_INPUT, POSITIVE_INPUT = 0x60FD, 1, 2


class Cia402Drive(Drive):
    """A `Drive` over CANopen. counts: those of `Cia402Node`."""

    step_s = 5e-3
    _node: Cia402Node

    def __init__(self, scene: Cia402Scene, axis: Axis) -> None:
        super().__init__(scene, axis)
        self._scene = scene
        self._control = Controlword.ENABLE
        self._beat_ns = 0

    def _connect(self) -> DriveDevice:
        self._node = Cia402Node(self._scene, self._axis, self.counts)
        self._control = Controlword.ENABLE
        return self._node

    @property
    def _sends_alone(self) -> bool:
        return self._supervisor.withdrawal is not None

    def _read_reports(self, now_ns: int) -> None:
        node, supervisor = self._node, self._supervisor
        supervisor.check_silence(now_ns, node.silence)
        # One TPDO has both position and state.
        if node.received_ns > supervisor.position_ns:
            supervisor.add_position(node.position_m, node.received_ns)
        if (fault := node.fault(now_ns)) is not None:
            supervisor.fail(fault)

    def _send(self, now_ns: int) -> None:
        """Send the present velocity, or the next step to enable a drive that is not enabled."""
        node, supervisor = self._node, self._supervisor
        enabled = node.state is State.ENABLED
        velocity = supervisor.velocity_to_send(now_ns) if enabled else 0
        self._control = (
            Controlword.ENABLE if enabled else towards_enabled(node.state, self._control)
        )
        supervisor.mark_sent(velocity, node.command(self._control, velocity))
        if now_ns - self._beat_ns >= self._scene.watchdog_ns // BEATS:
            self._beat_ns = now_ns
            node.send_heartbeat()
        node.start_again()

    def _pause(self) -> None:
        super()._pause()
        self._beat_ns = 0
        # The watchdog, armed anew, counts from our next heartbeat only.
        self._node.arm_watchdog()

    def _home_switch(self) -> bool | None:
        if self._scene.homing != "switch" or self._scene.homing_method is not None:
            return None
        # Reading takes longer than the watchdog permits between two commands.
        self._pause()
        try:
            inputs = self._node.read(DIGITAL_INPUTS)
        except DriveError as error:
            if error.kind is not FaultKind.REFUSED:
                raise
            return None
        return bool(inputs & (POSITIVE_INPUT if self._scene.inverted else NEGATIVE_INPUT))
