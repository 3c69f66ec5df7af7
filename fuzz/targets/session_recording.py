"""Recordings of a session (MCAP): the search for the session to replay."""

import io
import json
from base64 import b64encode
from contextlib import suppress

from mcap.writer import CompressionType, Writer

from fuzz.targets import scratch_folder
from fuzz.targets.control import seeds as controls
from fuzz.targets.frame import seeds as frames
from protocol.errors import SourceError
from telepulse.recording.session import longest_session
from telepulse.telemetry.schema import CLOCK, FRAME, SCHEMAS, STREAM

_FILE = scratch_folder() / "session.mcap"
WELCOME = 1


def seeds() -> list[bytes]:
    """Return a stream with a frame, in chunks and without."""
    return [_recording(chunks=chunks) for chunks in (True, False)]


def try_one(data: bytes) -> None:
    """Read a file: it is refused, or has a session whose frames are all valid."""
    _FILE.write_bytes(data)
    with suppress(SourceError):
        session = longest_session(_FILE)
        taken = list(session.frames())
        assert taken
        assert all(frame.values.shape[1] == len(session.description.channels) for frame in taken)


def _recording(chunks: bool) -> bytes:
    file = io.BytesIO()
    writer = Writer(file, compression=CompressionType.NONE, use_chunking=chunks, enable_crcs=chunks)
    writer.start()
    for topic, data in ((STREAM, controls()[WELCOME]), (FRAME, frames()[0]), (CLOCK, b"")):
        schema = writer.register_schema(SCHEMAS[topic][0], "jsonschema", b"{}")
        channel = writer.register_channel(topic, "json", schema)
        text = json.dumps({"data": b64encode(data).decode()}).encode()
        writer.add_message(channel, log_time=1, data=text, publish_time=1)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()
