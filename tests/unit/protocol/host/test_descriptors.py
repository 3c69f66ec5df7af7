import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress

import pytest

from protocol.host import descriptors
from protocol.host.descriptors import DescriptorSet, await_readable, await_writable
from tests.support.many_files import SELECT_TAKES, many_files

FOREVER_NS = 3_600_000_000_000
MS = 1_000_000


@contextmanager
def pipes(count: int) -> Iterator[list[tuple[int, int]]]:
    """Open pipes; each is its end for reading and its end for writing."""
    with ExitStack() as stack:
        opened = []
        for _ in range(count):
            opened.append(os.pipe())
            for number in opened[-1]:
                stack.callback(os.close, number)
        yield opened


@pytest.fixture(params=["few", "many"])
def numbers(request: pytest.FixtureRequest) -> Iterator[None]:
    """Low descriptors, and those that `select` does not take."""
    with many_files() if request.param == "many" else nullcontext():
        yield


@pytest.fixture(params=["ppoll", "poll", "select"])
def way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Linux's way to wait, that of systems without ppoll, and that of Windows."""
    if request.param != "ppoll":
        monkeypatch.setattr(descriptors, "_PPOLL", None)
    if request.param == "select":
        monkeypatch.delattr("select.poll")
    return str(request.param)


def test_a_wait_ends_at_what_comes_on_any_of_several(way: str) -> None:
    with pipes(3) as opened:
        waited = DescriptorSet([reading for reading, _ in opened])
        assert not waited.wait(0)
        assert not waited.wait(MS)
        assert waited.ready() == []
        for reading, writing in opened:
            os.write(writing, b"x")
            assert waited.wait(FOREVER_NS)
            assert waited.ready() == [reading]
            assert await_readable(reading, 60.0)
            os.read(reading, 1)
        assert not waited.wait(0)


def test_a_wait_takes_descriptors_of_any_number(numbers: None) -> None:
    with pipes(2) as opened:
        waited = DescriptorSet([reading for reading, _ in opened])
        (silent, _), (reading, writing) = opened
        assert not await_readable(silent, 0.001)
        assert await_writable(writing, 0.0)
        os.write(writing, b"x")
        assert waited.wait(FOREVER_NS)
        assert waited.ready() == [reading]
        assert await_readable(reading, 60.0)


def test_many_files_are_beyond_select() -> None:
    with many_files(), pipes(1) as [(reading, _)]:
        assert reading >= SELECT_TAKES


def test_an_end_counts_as_ready(way: str) -> None:
    near, far = socket.socketpair()
    with near:
        waited = DescriptorSet([near.fileno()])
        assert not waited.wait(0)
        far.close()
        assert waited.wait(FOREVER_NS)
        assert await_readable(near.fileno(), 60.0)


def test_a_full_pipe_is_awaited_until_it_is_read(numbers: None) -> None:
    with pipes(1) as [(reading, writing)]:
        os.set_blocking(writing, False)
        with suppress(BlockingIOError):
            while True:
                os.write(writing, bytes(65_536))
        assert not await_writable(writing, 0.001)
        reader = threading.Timer(0.02, os.read, (reading, 1 << 20))
        reader.start()
        assert await_writable(writing, None)
        reader.join()


def test_nothing_to_wait_for_is_a_pause() -> None:
    waited = DescriptorSet([])
    assert not waited.wait(MS)
    assert waited.ready() == []


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux's wait counts nanoseconds")
def test_a_wait_for_a_part_of_a_millisecond_does_not_last_for_one() -> None:
    with pipes(1) as [(reading, _)]:
        waited = DescriptorSet([reading])
        lasted_ns = []
        for _ in range(200):
            begun_ns = time.perf_counter_ns()
            waited.wait(100_000)
            lasted_ns.append(time.perf_counter_ns() - begun_ns)
    assert min(lasted_ns) < MS


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGALRM")
def test_a_signal_is_handled_and_is_nothing_that_has_come() -> None:
    handled = []
    before = signal.signal(signal.SIGALRM, lambda *_: handled.append(True))
    try:
        with pipes(1) as [(reading, _)]:
            signal.setitimer(signal.ITIMER_REAL, 0.01)
            assert not DescriptorSet([reading]).wait(200 * MS)
    finally:
        signal.signal(signal.SIGALRM, before)
    assert handled
