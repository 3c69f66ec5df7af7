import errno
import os
import random
import resource
import signal
import subprocess
import time
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from protocol.host.child_process import ChildProcess
from protocol.wire.messages import decode_frame, encode_frame
from telepulse.recording.mcap_reader import RecordedMessage, RecordingReader
from telepulse.telemetry.schema import EVENT, FRAME, STATUS, STREAM, TICK
from tests.support.keyring import Keyring
from tests.support.log_lines import unusual
from tests.support.nodes import free_address, process, run
from tests.support.telemetry_publisher import TelemetryPublisher, bye, numbered_frame, publishing

MODULE = "telepulse"
PATIENCE_S = 30.0
SECOND_NS = 1_000_000_000


def read(path: Path) -> tuple[dict[str, list[RecordedMessage]], RecordingReader]:
    """Return a recording's messages by topic, and its reader."""
    reader, by_topic = RecordingReader(path), {}
    for message in reader:
        by_topic.setdefault(message.topic, []).append(message)
    return by_topic, reader


def frames_of(path: Path) -> list[int]:
    """Return the numbers of the recorded frames; each frame has the bytes that were sent."""
    numbers = []
    for message in read(path)[0].get(FRAME, []):
        data = b64decode(message.fields["data"])
        numbers.append(decode_frame(data).first_sample // 5)
        assert data == encode_frame(numbered_frame(numbers[-1]))
    return numbers


def events_of(path: Path) -> list[str]:
    return [message.fields["name"] for message in read(path)[0][EVENT]]


@contextmanager
def recording(
    path: Path, *options: str, ring: Keyring | None = None, stdin: int | None = None
) -> Iterator[tuple[TelemetryPublisher, ChildProcess]]:
    """Publish a display's telemetry and record it."""
    address = free_address()
    with (
        publishing(address, ring and ring.server()) as display,
        process(MODULE, "record", address, str(path), *options, stdin=stdin) as recorder,
    ):
        yield display, recorder


def publish_for(display: TelemetryPublisher, seconds: float) -> None:
    """Publish a display's telemetry in real time; late ticks follow at once."""
    start_s, before = time.monotonic(), display.ticks
    while (passed_s := time.monotonic() - start_s) < seconds:
        display.publish(before + round(passed_s * 1000) - display.ticks)
        time.sleep(0.01)


def end(display: TelemetryPublisher, recorder: "subprocess.Popen[str]", status: int = 0) -> str:
    """End a display, check its recorder's exit status, and return the recorder's errors."""
    display.status("ended", final=True)
    output, errors = recorder.communicate(timeout=PATIENCE_S)
    assert (output, recorder.returncode) == ("", status), errors
    return errors


def test_everything_that_a_display_publishes_is_in_the_file(path: Path) -> None:
    with recording(path) as (display, recorder):
        display.begin()
        publish_for(display, 1.0)
        display.receive(-1, bye(5 * display.frames))
        errors = end(display, recorder)
    assert unusual(errors) == ""
    assert f"{display.frames} frames, {display.ticks} ticks" in errors
    assert frames_of(path) == list(range(display.frames))
    messages, reader = read(path)
    assert reader.whole
    assert [m.fields["instant_ns"] for m in messages[TICK]] == [
        number * 1_000_000 for number in range(display.ticks)
    ]
    assert len(messages[STATUS]) == display.publisher.captured.statuses_published
    assert len(messages[STREAM]) == 1
    assert events_of(path) == [
        *("begin", "session", "state", "join", "end of stream", "state", "end")
    ]
    assert abs(messages[TICK][-1].t_ns - time.time_ns()) < 60 * SECOND_NS


def test_marks_and_statements_are_in_the_file(path: Path) -> None:
    about = ("--about", "subject=S01", "--about", "side=left\x1b[2J")
    with recording(path, "--marks", *about, stdin=subprocess.PIPE) as (display, recorder):
        display.begin()
        publish_for(display, 0.5)
        assert recorder.stdin is not None
        for line in ("cuff on\n", "\n"):
            recorder.stdin.write(line)
            recorder.stdin.flush()
            publish_for(display, 0.3)
        errors = end(display, recorder)
    assert "mark: cuff on" in errors
    messages, reader = read(path)
    marks = {m.fields["message"]: m.t_ns for m in messages[EVENT] if m.fields["name"] == "mark"}
    assert list(marks) == ["cuff on", "mark 2"]
    assert 0.2e9 < marks["mark 2"] - marks["cuff on"] < 1e9
    assert reader.about == {"subject": "S01", "side": "left [2J"}


@pytest.mark.parametrize("seed", [1, 2])
def test_killed_it_loses_at_most_its_last_second(seed: int, tmp_path: Path) -> None:
    chance = random.Random(seed)
    for attempt in range(3):
        path = tmp_path / f"{attempt}.mcap"
        with recording(path) as (display, recorder):
            display.begin()
            publish_for(display, chance.uniform(1.1, 1.6))
            killed_ns = time.perf_counter_ns()
            recorder.kill()
            recorder.wait()
            due = sum(sent_ns < killed_ns - SECOND_NS for sent_ns in display.sent_ns)
        numbers = frames_of(path)
        assert numbers == list(range(len(numbers)))
        # On a machine so busy that the recorder did not run for half a second, try again.
        if len(numbers) >= due:
            return
    pytest.fail(f"{due} frames were older than a second, {len(numbers)} are in the file")


def test_messages_that_a_slow_recorder_misses_are_counted_and_shown(path: Path) -> None:
    with recording(path) as (display, recorder):
        display.begin()
        publish_for(display, 0.3)
        recorder.send_signal(signal.SIGSTOP)
        # Far more than sockets and their queues hold.
        display.publish(20_000)
        recorder.send_signal(signal.SIGCONT)
        publish_for(display, 0.5)
        errors = end(display, recorder, status=1)
    numbers = frames_of(path)
    assert numbers == sorted(set(numbers))
    missed = display.frames - len(numbers)
    assert missed > 0
    assert f"{missed} captured messages" in errors
    assert "missed" in events_of(path)


def test_a_full_disk_is_reported_once_and_retried_until_nothing_is_missing(path: Path) -> None:
    with recording(path) as (display, recorder):
        full_bytes = fill_up(display, recorder, path)
        # Whole chunks up to the limit, readable while it is full.
        assert 0 < len(frames_of(path)) < display.frames
        limit(recorder, resource.RLIM_INFINITY)
        publish_until_larger(display, path, full_bytes)
        errors = end(display, recorder)
    assert errors.count(os.strerror(errno.EFBIG)) == 1
    assert "is written again, 0 messages lost" in errors
    assert frames_of(path) == list(range(display.frames))
    assert events_of(path).count("disk") == 2


def limit(process: ChildProcess, size_bytes: int) -> None:
    """Limit the size of a process's files, which acts as a full disk and needs no rights."""
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (size_bytes, resource.RLIM_INFINITY))


def fill_up(display: TelemetryPublisher, recorder: ChildProcess, path: Path) -> int:
    """Publish until the recorder can write no more, and for a while longer; return the limit."""
    display.begin()
    publish_until_larger(display, path, 5_000)
    full_bytes = path.stat().st_size + 5_000
    limit(recorder, full_bytes)
    publish_for(display, 0.8)
    assert path.stat().st_size <= full_bytes
    return full_bytes


def publish_until_larger(display: TelemetryPublisher, path: Path, size_bytes: int) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not path.exists() or path.stat().st_size <= size_bytes:
        assert time.monotonic() < end_s, "nothing is written"
        publish_for(display, 0.1)


def test_a_key_that_is_allowed_later_is_recorded_from_then_on(path: Path, tmp_path: Path) -> None:
    ring = Keyring(tmp_path / "keys")
    ring.allow("somebody")
    keys = ("--key", ring.path("notes"), "--peer", ring.path("wrist", "pub"))
    with recording(path, *keys, ring=ring) as (display, recorder):
        display.welcome()
        while not display.authenticator.rejected:
            publish_for(display, 0.1)
        ring.allow("notes")
        while not display.publisher.captured.wanted:
            publish_for(display, 0.1)
        publish_for(display, 0.3)
        errors = end(display, recorder)
    assert errors.count("telepulse keys allow notes.pub") == 1
    assert len(read(path)[0][STREAM]) == 1
    numbers = frames_of(path)
    assert 0 < numbers[0] < numbers[-1] == display.frames - 1
    assert numbers == list(range(numbers[0], display.frames))


def test_before_the_first_message_silence_ends_it_only_after_its_display_has_ended(
    path: Path,
    tmp_path: Path,
) -> None:
    left = tmp_path / "left.mcap"
    silent = ("--until-silent", "0.3", "--display-pid")
    with recording(path, *silent, str(os.getpid())) as (display, recorder):
        display.begin()
        nobody = str(os.getpid() + 1)
        result = run(MODULE, "record", free_address(), str(left), *silent, nobody, "--quiet")
        assert (result.returncode, result.stderr.count("\n")) == (1, 1)
        assert "nothing came for 0.3 s" in result.stderr
        assert not left.exists()
        # It has been silent for longer than the other one.
        assert recorder.poll() is None
        publish_for(display, 0.2)
        assert unusual(end(display, recorder)) == ""
    assert frames_of(path)
