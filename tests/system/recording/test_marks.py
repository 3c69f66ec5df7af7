"""Marks of a running display by a key in its terminal and by a command, and its statements."""

import os
import sys
import termios
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zmq

from display_node.telemetry.publisher import Publisher
from protocol import sockets
from protocol.host.child_process import ChildProcess
from protocol.sockets import Context
from protocol.wire.marks import MARK, MarkRequest, pack_request
from telepulse.processes import free_addresses
from telepulse.recording.reader import RecordingReader
from telepulse.telemetry.schema import EVENT
from tests.support.log_lines import refused
from tests.support.nodes import RADIAL, ROOT, process, run
from tests.support.waiting import PATIENCE_S, until

MODULE = "telepulse"
SECOND_NS = 1_000_000_000


@contextmanager
def in_a_terminal(*arguments: str) -> Iterator[tuple[ChildProcess, int]]:
    """Run a display node whose standard streams are a terminal; yield it and the other side."""
    leader, follower = os.openpty()
    environment = os.environ | {"COLUMNS": "100", "LINES": "50", "TERM": "xterm"}
    streams = dict.fromkeys(("stdin", "stdout", "stderr"), follower)
    # A session of its own with the terminal as the controlling one, as a shell has it.
    take = "import fcntl, os, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0)"
    go = f"{take}; from display_node.cli import main; sys.argv[1:] = {list(arguments)!r}; main()"
    try:
        with ChildProcess("display", "-c", go, cwd=ROOT, env=environment, **streams) as display:
            os.close(follower)
            yield display, leader
    finally:
        os.close(leader)


def shown(leader: int, word: str, within_s: float = PATIENCE_S) -> str:
    """Return what a terminal shows until a word."""
    output, until_s = b"", time.monotonic() + within_s
    os.set_blocking(leader, False)
    while word not in output.decode(errors="replace"):
        assert time.monotonic() < until_s, output.decode(errors="replace")
        try:
            output += os.read(leader, 65_536)
        except BlockingIOError:
            time.sleep(0.02)
    return output.decode(errors="replace")


@pytest.mark.skipif(sys.platform != "linux", reason="takes a controlling terminal as on Linux")
def test_a_key_and_a_command_mark_the_recording_and_the_terminal_is_restored(
    tmp_path: Path,
) -> None:
    address, telemetry = free_addresses(2)
    path = tmp_path / "marked.mcap"
    options = ("--connect", address, "--telemetry", telemetry, "--record", str(path))
    about = ("--about", "subject=S01", "--about=notes=after rest")
    with (
        process("sensing_node.cli", str(RADIAL), "--bind", address, "--quiet"),
        in_a_terminal(str(RADIAL), *options, *about) as (display, leader),
    ):
        before = termios.tcgetattr(leader)[3]
        shown(leader, "force felt")
        until(lambda: not termios.tcgetattr(leader)[3] & termios.ECHO)
        pressed_ns = time.time_ns()
        os.write(leader, b"xm")
        shown(leader, "last: mark 1")
        command = run(MODULE, "mark", telemetry, "cuff\x1b on")
        assert (command.returncode, command.stdout) == (0, "mark: cuff  on\n")
        shown(leader, "last: cuff  on")
        display.terminate()
        shown(leader, "sent =")
        assert display.wait(PATIENCE_S) == 0
        assert termios.tcgetattr(leader)[3] == before
    reader = RecordingReader(path)
    marks = {
        message.fields["message"]: message.t_ns
        for message in reader
        if message.topic == EVENT and message.fields["name"] == "mark"
    }
    assert list(marks) == ["mark 1", "cuff  on"]
    assert -0.01e9 < marks["mark 1"] - pressed_ns < 2e9
    assert reader.about == {"subject": "S01", "notes": "after rest"}
    # The command line is published to readers of the telemetry, the statements are not.
    assert b"S01" not in str(reader.provenance).encode()
    assert "after rest" not in str(reader.provenance)


def test_statements_without_a_recording_are_refused() -> None:
    line = refused("display_node.cli", str(RADIAL), "--about", "subject=S01")
    assert "add --record" in line


def test_a_mark_of_a_display_that_does_not_run_is_reported() -> None:
    (address,) = free_addresses(1)
    result = run(MODULE, "mark", address, "cuff on")
    assert result.returncode == 1
    assert "did not answer within 5 s" in result.stderr


def test_a_flood_of_marks_is_cut_off_and_the_marks_of_others_continue(context: Context) -> None:
    (address,) = free_addresses(1)
    publisher = Publisher(sockets.bind(context, zmq.XPUB, address), run=1)
    modest, greedy = (sockets.connect(context, zmq.XSUB, address) for _ in range(2))
    modest.send(b"\1" + MARK)

    def request(socket: sockets.Socket, at_ns: int | None = None) -> None:
        sockets.send(socket, pack_request(MarkRequest(1, at_ns, "here")))

    def marked() -> bool:
        publisher.await_recorder(0.01)
        return bool(modest.poll(5) and modest.recv_multipart())

    request(modest)
    until(marked)
    request(modest, time.perf_counter_ns() - 61 * SECOND_NS)
    request(modest, time.perf_counter_ns() + 2 * SECOND_NS)
    sockets.send(modest, b"\2garbage")
    until(lambda: marked() or publisher.rejected["mark"] == 3)

    def cut() -> bool:
        for _ in range(50):
            request(greedy)
        publisher.await_recorder(0.01)
        return publisher.rejected["subscription"] > 0

    until(cut)
    while modest.poll(100):
        modest.recv_multipart()
    request(modest)
    until(marked)
