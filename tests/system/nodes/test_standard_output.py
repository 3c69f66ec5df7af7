"""A stream that is written by a thread of its own, into what takes all, nothing, or fails."""

import io
import os
import sys
import time
from contextlib import closing

import pytest

from protocol.host import output
from protocol.host.output import MAX_QUEUED, QueuedStream
from tests.support.unread import KINDS, fill, unread

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="it is not used there")

LINE = "x" * 99 + "\n"


def queued(number: int) -> QueuedStream:
    return QueuedStream(io.TextIOWrapper(io.FileIO(number, "w", closefd=False), "utf-8"))


@pytest.mark.parametrize("kind", KINDS)
def test_no_output_holds_up_its_writer(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(output, "STUCK_S", 0.1)
    with unread(kind) as number:
        stream = queued(number)
        for _ in range(2 * MAX_QUEUED // len(LINE)):
            print(LINE, end="", file=stream, flush=True)
        begin_s = time.monotonic()
        stream.finish()
        assert time.monotonic() - begin_s < output.CLOSE_WITHIN_S
        assert stream.dropped > 0


def test_bytes_are_refused_as_by_any_text_stream() -> None:
    """click's help tries them."""
    with unread("closed") as number, pytest.raises(TypeError, match="not bytes"):
        queued(number).write(b"")  # type: ignore[arg-type]


def test_what_is_dropped_is_counted_and_reported_once_output_is_possible_again() -> None:
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


def test_all_is_written_before_it_ends() -> None:
    out, into = os.pipe()
    stream = queued(into)
    stream.write("grüße\n")
    stream.write("\udc80")
    stream.finish()
    os.close(into)
    with os.fdopen(out, "rb") as reader:
        assert reader.read() == "grüße\n\\udc80".encode()


def test_a_descriptor_that_others_made_non_blocking_loses_nothing() -> None:
    out, into = os.pipe()
    fill_bytes = fill(into)
    os.set_blocking(into, False)
    stream = queued(into)
    stream.write(LINE)
    with closing(os.fdopen(out, "rb")) as reader:
        reader.read(fill_bytes)
        assert reader.readline() == LINE.encode()
    assert stream.dropped == 0
    os.close(into)
