"""Messages of a CiA 402 drive: its TPDOs, emergencies, and answers about objects."""

import struct
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from unittest.mock import patch

import can

from display_node.plant.scene import StepperScene
from protocol.config.scene import validate
from protocol.errors import DriveError
from protocol.wire.description import LayerTable
from pulse_drives.axis import build_axis
from pulse_drives.cia402 import node as cia402_node
from pulse_drives.cia402.node import EMERGENCY, TPDO1, TPDO2, Cia402Node
from pulse_drives.scene import Cia402Scene

REQUEST, ANSWER = 0x600, 0x580
SAYS = (TPDO1, TPDO2, EMERGENCY)
# Position and velocity, the supported modes, the profile; signed and unsigned, of several sizes.
OBJECTS = (0x6064, 0x606C, 0x6502, 0x1000, 0x6061, 0x6041)
PIECE = 9
_SCENE = validate(
    {"kind": "cia402", "interface": "virtual", "channel": "fuzz"}, Cia402Scene, where="fuzz"
)
_STEPPER = validate({"kind": "stepper"}, StepperScene, where="fuzz")


class _Bus:
    """A bus that answers each request with the next piece of an input."""

    channel_info = "fuzz"

    def __init__(self) -> None:
        self.answers: list[bytes] = []
        self.hear: Callable[[int, bytearray], None] = lambda can_id, data: None

    def send(self, message: can.Message) -> None:
        if message.arbitration_id == REQUEST + _SCENE.node and self.answers:
            self.hear(ANSWER + _SCENE.node, bytearray(self.answers.pop(0)))

    def shutdown(self) -> None:
        """Leave it as it is: a node that cannot start closes its bus, and the next one uses it."""


_BUS = _Bus()


def _node() -> Cia402Node:
    # Messages are delivered by `hear` in this thread, not by a listener.
    with (
        patch.object(cia402_node, "open_bus", lambda _: _BUS),
        patch.object(cia402_node, "SDO_TIMEOUT_S", 1e-4),
        patch.object(can, "Notifier"),
    ):
        node = Cia402Node(
            _SCENE,
            build_axis(_SCENE, _STEPPER, _STEPPER.deepest_m(LayerTable().layer(), 2.5)),
            Counter(),
        )
    network = node._network
    _BUS.hear = lambda can_id, data: network.notify(can_id, data, 0.0)
    return node


_NODE = _node()


def seeds() -> list[bytes]:
    """Return each TPDO, an emergency, and answers: expedited, segmented, an abort."""
    said = [
        b"\x00" + struct.pack("<Hi", 0x27, -5) + b"\0\0",
        b"\x01" + struct.pack("<iH", 100, 0) + b"\0\0",
        b"\x02" + bytes.fromhex("1043 01 0000000000"),
    ]
    answers = [
        bytes.fromhex("43 646000 05000000"),
        bytes.fromhex("4f 616000 09000000"),
        bytes.fromhex("41 646000 04000000") + b"\x83" + bytes.fromhex("07 05000000 000000"),
        bytes.fromhex("80 646000 00000206"),
    ]
    return [b"".join(said), *(b"\x83" + answer for answer in answers)]


def try_one(data: bytes) -> None:
    """Receive pieces; each is stored or counted, and an object is a number or a DriveError.

    A piece is a byte that chooses its kind, and up to eight of data.
    """
    pieces = [data[start : start + PIECE] for start in range(0, len(data), PIECE)]
    _BUS.answers = [piece[1:] for piece in pieces if piece[0] & 0x80]
    for piece in pieces:
        if piece[0] & 0x80:
            with suppress(DriveError):
                _NODE.read(OBJECTS[piece[0] % len(OBJECTS)])
        else:
            _BUS.hear(SAYS[piece[0] % len(SAYS)] + _SCENE.node, bytearray(piece[1:]))
