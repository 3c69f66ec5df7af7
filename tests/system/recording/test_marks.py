"""Marks of a running display by a command, and its statements."""

import time
from pathlib import Path

import zmq

from display_node.telemetry.publisher import Publisher
from protocol import sockets
from protocol.sockets import Context
from protocol.wire.marks import MARK, MarkRequest, pack_request
from telepulse.processes import free_addresses
from telepulse.recording.mcap_reader import RecordingReader
from telepulse.telemetry.schema import EVENT
from tests.support.live_display import await_state, subscribe
from tests.support.nodes import RADIAL, process, run
from tests.support.waiting import PATIENCE_S, until

MODULE = "telepulse"
SECOND_NS = 1_000_000_000


def test_a_command_marks_the_recording(context: Context, tmp_path: Path) -> None:
    address, telemetry = free_addresses(2)
    path = tmp_path / "marked.mcap"
    options = ("--connect", address, "--telemetry", telemetry, "--record", str(path))
    about = ("--about", "subject=S01", "--about=notes=after rest")
    with (
        process("sensing_node.cli", str(RADIAL), "--bind", address, "--quiet"),
        process("display_node.cli", str(RADIAL), "--no-screen", *options, *about) as display,
    ):
        await_state(subscribe(context, telemetry), "playing")
        marked_ns = time.time_ns()
        for text, mark in (("", "mark 1"), ("cuff\x1b on", "cuff  on")):
            command = run(MODULE, "mark", telemetry, *([text] if text else []))
            assert (command.returncode, command.stdout) == (0, f"mark: {mark}\n")
        display.terminate()
        output, _ = display.communicate(timeout=PATIENCE_S)
        assert "The pulse was felt" in output
        assert display.returncode == 0
    reader = RecordingReader(path)
    marks = {
        message.fields["message"]: message.t_ns
        for message in reader
        if message.topic == EVENT and message.fields["name"] == "mark"
    }
    assert list(marks) == ["mark 1", "cuff  on"]
    assert -0.01e9 < marks["mark 1"] - marked_ns < 5e9
    assert reader.about == {"subject": "S01", "notes": "after rest"}
    # The command line is published to readers of the telemetry, the statements are not.
    assert b"S01" not in str(reader.provenance).encode()
    assert "after rest" not in str(reader.provenance)


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
