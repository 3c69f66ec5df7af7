"""Output through a thread of its own, into descriptors that accept all, nothing, or fail."""

import io
import os
import sys
from contextlib import closing

import pytest

from protocol.host.output import MAX_QUEUED, QueuedStream
from tests.support.unread import fill

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="not used on Windows")

LINE = "x" * 99 + "\n"


def queued(number: int) -> QueuedStream:
    return QueuedStream(io.TextIOWrapper(io.FileIO(number, "w", closefd=False), "utf-8"))


def test_dropped_lines_are_counted_and_reported_once_output_is_possible_again() -> None:
    out, into = os.pipe()
    with closing(os.fdopen(out, "rb")) as reader:
        filled = fill(into)
        stream = queued(into)
        written = 2 * MAX_QUEUED // len(LINE)
        for _ in range(written):
            stream.write(LINE)
        dropped = stream.dropped
        assert 0 < dropped < written
        assert reader.read(filled) == b"." * filled
        kept = reader.read((written - dropped) * len(LINE))
        assert kept == LINE.encode() * (written - dropped)
        note = reader.readline().decode()
        assert note == f"{dropped} lines of output dropped: it could not be written\n"
        stream.write("after\n")
        assert reader.readline() == b"after\n"
        stream.finish()
        os.close(into)
        assert reader.read() == b""


@pytest.mark.parametrize("blocking", [True, False])
def test_all_is_written_before_the_end_also_to_a_non_blocking_descriptor(blocking: bool) -> None:
    out, into = os.pipe()
    filled = 0 if blocking else fill(into)
    os.set_blocking(into, blocking)
    stream = queued(into)
    stream.write("grüße\n")
    stream.write("\udc80")
    with closing(os.fdopen(out, "rb")) as reader:
        reader.read(filled)
        stream.finish()
        os.close(into)
        assert reader.read() == "grüße\n\\udc80".encode()
    assert stream.dropped == 0
