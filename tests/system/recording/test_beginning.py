"""The recording of `display-node --record`: its first tick, and a recorder that ends early."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zmq

from protocol.faults import Part, notes_of
from protocol.host.child_process import ChildProcess
from protocol.sockets import Context, Socket, receive_multipart
from protocol.wire.telemetry import CAPTURE, TRACE, read_trace
from telepulse.processes import free_addresses
from telepulse.recording.mcap_reader import RecordingReader
from telepulse.telemetry.schema import TICK
from tests.support.live_display import await_state, await_status, subscribe
from tests.support.nodes import RADIAL, process
from tests.support.waiting import PATIENCE_S, until


@contextmanager
def recorded_display(telemetry: str, path: Path) -> Iterator[ChildProcess]:
    """Run both nodes; the display records."""
    (address,) = free_addresses(1)
    options = ("--connect", address, "--telemetry", telemetry, "--record", str(path))
    with (
        process("sensing_node.cli", str(RADIAL), "--bind", address, "--quiet"),
        process("display_node.cli", str(RADIAL), "--no-screen", *options) as display,
    ):
        yield display


def first_tick_ns(reader: Socket) -> int:
    """Return the time of the first tick that a display publishes."""
    found = list[int]()

    def received() -> bool:
        for topic, data in receive_multipart(reader):
            if topic == TRACE:
                found.append(int(read_trace(data)[0].now_ns[0]))
        return bool(found)

    until(received)
    return found[0]


def test_a_recording_has_the_first_tick_although_a_page_has_waited_already(
    context: Context, tmp_path: Path
) -> None:
    (telemetry,) = free_addresses(1)
    path = tmp_path / "whole.mcap"
    page = subscribe(context, telemetry)
    page.setsockopt(zmq.RCVHWM, 0)
    page.subscribe(CAPTURE)
    with recorded_display(telemetry, path) as display:
        began_ns = first_tick_ns(page)
        await_state(page, "playing")
        display.terminate()
        display.communicate(timeout=PATIENCE_S)
        assert display.returncode == 0
    recorded = (message for message in RecordingReader(path) if message.topic == TICK)
    assert next(recorded).fields["now_ns"] == began_ns


def recorder_of(display: ChildProcess) -> int:
    """Return the process id of a display's recorder."""
    children = Path(f"/proc/{display.pid}/task/{display.pid}/children").read_text(encoding="utf-8")
    (found,) = (
        int(child)
        for child in children.split()
        if "telepulse.cli.record" in Path(f"/proc/{child}/cmdline").read_text(encoding="utf-8")
    )
    return found


@pytest.mark.skipif(sys.platform != "linux", reason="the recorder is found in /proc")
@pytest.mark.parametrize("signum", [signal.SIGKILL, signal.SIGTERM])
def test_a_recorder_that_ends_early_is_an_alert_at_once_and_play_goes_on(
    context: Context, tmp_path: Path, signum: signal.Signals
) -> None:
    (telemetry,) = free_addresses(1)
    reader = subscribe(context, telemetry)
    with recorded_display(telemetry, tmp_path / "early.mcap") as display:
        playing = await_state(reader, "playing")
        assert not notes_of(playing.summary)

        os.kill(recorder_of(display), signum)
        alert = await_status(reader, lambda status: bool(notes_of(status.summary)), within_s=2.0)
        (note,) = notes_of(alert.summary)
        assert note.part is Part.RECORDER
        assert alert.state == "playing"
        played = alert.summary["samples"]["played"]
        await_status(reader, lambda status: status.summary["samples"]["played"] > played + 500)
        display.terminate()
        output, errors = display.communicate(timeout=PATIENCE_S)
    assert "The recorder: it is gone" in output
    assert errors.count("recorder: it is gone") == 1
    assert display.returncode == 1
