"""A database of CAN messages with a film's force, a scene that reads it, and its messages."""

import uuid
from pathlib import Path

import can

from protocol.config.scene import validate
from pulse_sensors.can_bus import CanScene

DATABASE = """VERSION ""
NS_ :
BS_:
BU_: Board Host
BO_ 291 Film: 4 Board
 SG_ Force : 0|16@1- (0.0001,0) [-3.2768|3.2767] "N" Host
 SG_ Count : 16|8@1+ (1,0) [0|255] "" Host
BO_ 292 Other: 2 Board
 SG_ Temperature : 0|16@1- (0.1,0) [-40|125] "C" Host
BO_ 294 Paged: 3 Board
 SG_ Page M : 0|8@1+ (1,0) [0|1] "" Host
 SG_ Squeeze m0 : 8|16@1- (0.0001,0) [-3.2768|3.2767] "N" Host
 SG_ Warmth m1 : 8|16@1- (0.1,0) [-40|125] "C" Host
BO_ 295 Floating: 8 Board
 SG_ Single : 0|32@1- (1,0) [0|0] "N" Host
 SG_ Tick : 32|32@1- (1,0) [0|0] "" Host
BO_ 293 Twin: 2 Board
 SG_ Temperature : 0|16@1- (0.1,0) [-40|125] "C" Host
SIG_VALTYPE_ 295 Single : 1;
SIG_VALTYPE_ 295 Tick : 1;
"""


def write_database(folder: Path) -> None:
    (folder / "film.dbc").write_text(DATABASE, encoding="utf-8")


def can_scene(channel: str = "none", **keys: object) -> CanScene:
    table = {
        **{"kind": "can", "interface": "virtual", "channel": channel, "database": "film.dbc"},
        **{"rate": "1 kHz", "unit": "N"},
        **({} if "signals" in keys else {"signal": "Force"}),
    }
    return validate(table | keys, CanScene, "scene")


def film_message(number: int, force_n: float = 0.25, at_s: float | None = None) -> can.Message:
    """Return message `number`; at_s: its time, by default one message each ms."""
    data = round(force_n * 1e4).to_bytes(2, "little", signed=True) + bytes([number % 256, 0])
    when_s = 1e9 + number * 1e-3 if at_s is None else at_s
    return can.Message(when_s, arbitration_id=291, is_extended_id=False, data=data)


def udp_multicast_reason() -> str | None:
    """Return why udp_multicast cannot carry CAN here; None where it can."""
    channel = f"239.74.163.{2 + uuid.uuid4().int % 200}"
    try:
        with (
            can.Bus(interface="udp_multicast", channel=channel) as one,
            can.Bus(interface="udp_multicast", channel=channel) as other,
        ):
            one.send(can.Message(arbitration_id=1, is_extended_id=False, data=b"\1"))
            return None if other.recv(2.0) else "no multicast comes through"
    except (OSError, can.CanError) as error:
        return str(error)
