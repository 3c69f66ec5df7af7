"""A live stream in Python has every sample, in order, of the sensing node's own pulse."""

import ctypes
import socket
import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest

import telepulse
from protocol.errors import ArgumentError, ProtectionError, SourceError
from sensing_node.scene import build_source
from telepulse.scene import load_scene
from telepulse.testing.conformance import check_release
from tests.support.log_lines import strays
from tests.support.nodes import RADIAL, process
from tests.support.waiting import until

MODULE = "sensing_node.cli"


@pytest.mark.smoke
def test_no_sample_is_missing_while_the_reader_computes(address: str) -> None:
    sensing = (MODULE, str(RADIAL), "--bind", address, "--seconds", "3")
    with telepulse.connect(address) as stream, process(*sensing) as node:
        description = stream.describe()
        blocks = [stream.read(700)]
        # Holds the interpreter, as a long computation in C does: nothing else of Python runs.
        ctypes.PyDLL(None).usleep(1_200_000)
        blocks += stream.blocks(700)
        _, errors = node.communicate(timeout=20)
    assert (description.rate_hz, description.channels[0].unit) == (1000.0, "N")
    assert {len(block.values) for block in blocks[:-1]} == {700}
    values = np.concatenate([block.values for block in blocks])
    t_ns = np.concatenate([block.t_ns for block in blocks])
    first = blocks[0].first_sample
    assert first + len(values) == 3_000
    assert (stream.lost, stream.dropped) == (0, 0)
    scene = load_scene(RADIAL)
    expected = build_source(scene.sensing, RADIAL.parent).take(3_000)[first:]
    np.testing.assert_array_equal(values, expected.astype("<f4"))
    assert set(np.diff(t_ns).tolist()) == {1_000_000}
    assert abs(blocks[-1].unix_s[-1] - time.time()) < 30
    assert not strays(errors)
    with pytest.raises(SourceError, match="the stream has ended"):
        stream.read(1)


def test_who_cannot_be_received_is_named_in_one_line(address: str) -> None:
    with telepulse.connect(address) as stream:
        with pytest.raises(SourceError, match=f"{address}: no sample came for 0.2 s"):
            stream.read(10, timeout_s=0.2)
        with pytest.raises(ArgumentError, match=r"^count: must be a whole number from 1 .*, got 0"):
            stream.read(0)
        with pytest.raises(ArgumentError, match=r"^timeout_s: must be a number .*, got '1'$"):
            stream.read(1, timeout_s="1")
    with pytest.raises(ProtectionError, match=r"192\.0\.2\.1"):
        telepulse.connect("tcp://192.0.2.1:5555")


def test_a_closed_stream_leaves_no_request_to_connect() -> None:
    with socket.socket() as listening, ExitStack() as stack:
        listening.bind(("127.0.0.1", 0))
        listening.listen(0)
        # Its queue is full, so that a request to connect has no answer.
        for _ in range(3):
            waiting = stack.enter_context(socket.socket())
            waiting.setblocking(False)
            waiting.connect_ex(listening.getsockname())
        with check_release("close"):
            stream = telepulse.connect(f"tcp://127.0.0.1:{listening.getsockname()[1]}")
            (route,) = stream._connection.routes
            until(lambda: route.data_port._probe)
            stream.close()


def test_a_closed_stream_is_named_as_closed(address: str) -> None:
    with telepulse.connect(address) as stream:
        closing = threading.Timer(0.2, stream.close)
        closing.start()
        # The one that waits is woken.
        with pytest.raises(SourceError, match=f"^{address}: this stream was closed$"):
            stream.read(1, timeout_s=60)
        closing.join()
    for call in (lambda: stream.read(1), stream.describe, lambda: list(stream.blocks(1))):
        with pytest.raises(SourceError, match=f"^{address}: this stream was closed$"):
            call()
