"""CAN messages against a database: 8 bytes of each input are a message's time, then its data."""

import struct
from collections.abc import Iterator

import can

from fuzz.packets import check_fed
from fuzz.targets import scratch_folder
from protocol.config.scene import validate
from pulse_sensors.can_bus import CanDecoder, CanScene

DATABASE = """VERSION ""
NS_ :
BS_:
BU_: Board Host
BO_ 291 Film: 8 Board
 SG_ Page M : 0|2@1+ (1,0) [0|3] "" Host
 SG_ Force m0 : 8|32@1- (1,0) [0|0] "N" Host
 SG_ Force2 m1 : 8|16@1- (0.1,0) [-40|125] "C" Host
 SG_ Count : 40|24@1+ (1,0) [0|0] "" Host
SIG_VALTYPE_ 291 Force : 1;
"""
_FOLDER = scratch_folder()
_FOLDER.joinpath("film.dbc").write_text(DATABASE, encoding="utf-8")
_TABLE = {
    **{"kind": "can", "interface": "virtual", "channel": "fuzz", "database": "film.dbc"},
    **{"signal": "Force", "counter": "Count", "rate": "1 kHz", "unit": "N"},
}
SCENE = validate(_TABLE, CanScene, where="fuzz")
_DECODER = CanDecoder(SCENE, _FOLDER)
# Time in µs, within the range of an interface; length and flags.
_HEAD = struct.Struct("<qB")


def seeds() -> list[bytes]:
    """Return messages with each page, and one that is an error."""
    numbered = (
        _HEAD.pack(1_000 * n, 8) + struct.pack("<Bf", n == 3, 0.25) + n.to_bytes(3, "little")
        for n in range(6)
    )
    return [b"".join(numbered), _HEAD.pack(0, 0x40)]


def try_one(data: bytes) -> None:
    """Decode messages of any content and time."""
    _DECODER.reset()
    _DECODER.rejected.clear()
    check_fed(_DECODER, _messages(data))


def _messages(data: bytes) -> Iterator[can.Message]:
    while len(data) >= _HEAD.size:
        (time_us, how), data = _HEAD.unpack_from(data), data[_HEAD.size :]
        content, data = data[: how & 0xF], data[how & 0xF :]
        # A classic frame's data is at most 8 bytes.
        yield can.Message(
            time_us * 1e-6,
            arbitration_id=291,
            is_error_frame=bool(how & 0x40),
            data=content[:8],
        )
