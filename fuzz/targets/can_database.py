"""CAN databases: cantools' reading of a file, and our look-up in it."""

from contextlib import suppress

import can

from fuzz.targets import scratch_folder
from fuzz.targets.can_messages import DATABASE, SCENE
from protocol.errors import SourceError
from pulse_sensors.can_bus import CanDecoder

_FOLDER = scratch_folder()


def seeds() -> list[bytes]:
    """Return a database."""
    return [DATABASE.encode()]


def try_one(data: bytes) -> None:
    """Read a file; either it is refused, or any message can be decoded by it."""
    (_FOLDER / "film.dbc").write_bytes(data)
    with suppress(SourceError):
        decoder = CanDecoder(SCENE, _FOLDER)
        for length in (0, 8):
            decoder.feed(can.Message(arbitration_id=291, data=bytes(range(length))))
