"""Scenes and recordings made to take memory, time or stack: one line, at little memory."""

import json
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, IndexType, Writer

from telepulse.recording.mcap_writer import PROVENANCE
from telepulse.telemetry.schema import EVENT, FRAME, SCHEMAS, TICK
from tests.support.nodes import run, run_python

PATIENCE_S = 120.0
MOST_KB = 300_000
DEEP = 100_000
COMMANDS = {
    "report": ("report", "--out", "out"),
    "export": ("export", "--to", "csv", "--out", "out"),
    "replay": ("replay", "--seconds", "1"),
    "study": ("study", "record", "--link", "delay=10ms"),
}
SCENES = {
    "a device": 'extends = "/dev/zero"\n',
    "a pipe": 'extends = "pipe.toml"\n',
    "a header of many parts": "[" + ".".join(["a"] * DEEP) + "]\nx = 1\n",
    "a key of many parts": "display." + ".".join(["a"] * DEEP) + " = 1\n",
    "many keys": "".join(f"k{number} = 1\n" for number in range(300_000)),
    "a long name": f'extends = "{"x" * DEEP}"\n',
    "a null character": 'extends = "a\\u0000b.toml"\n',
    "nested arrays": "x = " + "[" * DEEP + "]" * DEEP + "\n",
    "nested tables": "x = " + "{a = " * 900 + "1" + "}" * 900 + "\n",
    "a source that is a device": (
        'extends = "radial"\n[sensing.source]\nkind = "recording"\npath = "/dev/zero"\n'
    ),
}


# A process has the memory of its parent at first: that of pytest would be measured.
MEASURED = """
import json, resource, subprocess, sys
resource.setrlimit(resource.RLIMIT_DATA, (1 << 32, 1 << 32))
command = [sys.executable, "-m", "telepulse", *sys.argv[1:]]
done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
most_kb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
print(json.dumps([done.returncode, most_kb, done.stdout]))
"""


def refused(folder: Path, *arguments: str) -> str:
    """Run a command with a bound of its memory, and return the one line that it refuses with."""
    done = run_python("-c", MEASURED, *arguments, cwd=folder, timeout=PATIENCE_S)
    status, most_kb, output = json.loads(done.stdout)
    assert status == 2, output
    assert most_kb < MOST_KB
    (line,) = output.splitlines()
    assert line.startswith("telepulse: ")
    return str(line)


@pytest.mark.skipif(sys.platform != "linux", reason="devices and memory as Linux has them")
@pytest.mark.timeout(PATIENCE_S)
@pytest.mark.parametrize("text", SCENES.values(), ids=SCENES)
def test_a_scene_is_refused_before_it_is_read_whole(text: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.toml")
    (tmp_path / "scene.toml").write_text(text)
    line = refused(tmp_path, "simulate", "scene.toml", "--seconds", "1")
    assert len(line) < 300


CONTROL = "\x1b[31mred\x07\u202e\nsecond"


@pytest.mark.skipif(sys.platform != "linux", reason="memory as Linux states it")
@pytest.mark.timeout(PATIENCE_S)
def test_a_name_of_a_scene_changes_no_screen(tmp_path: Path) -> None:
    (tmp_path / "scene.toml").write_text(f"extends = {json.dumps(CONTROL)}\n")
    line = refused(tmp_path, "simulate", "scene.toml")
    assert r"\x1b[31mred\x07\u202e\nsecond" in line


@pytest.mark.timeout(PATIENCE_S)
def test_an_event_of_a_recording_changes_no_screen(tmp_path: Path) -> None:
    event = json.dumps({"level": 2, "name": CONTROL, "message": CONTROL}).encode()
    begin = json.dumps({"level": 2, "name": "begin", "message": CONTROL}).encode()

    def fill(writer: Writer, channels: dict[str, int]) -> None:
        for data in (begin, event):
            writer.add_message(channels[EVENT], 1, data, 1)
        writer.add_metadata(PROVENANCE, {"version": CONTROL, "host": CONTROL})

    write(tmp_path / "run.mcap", fill)
    done = run("telepulse", "report", str(tmp_path / "run.mcap"), "--out", str(tmp_path / "page"))
    assert done.returncode == 0
    printed = done.stdout + done.stderr
    assert "red" in printed
    assert [line for line in printed.splitlines() if not line.isprintable()] == []


def many(topic: str, data: bytes, count: int) -> Callable[[Writer, dict[str, int]], None]:
    def fill(writer: Writer, channels: dict[str, int]) -> None:
        for _ in range(count):
            writer.add_message(channels[topic], 1, data, 1)

    return fill


def metadata(entries: int, each: dict[str, str]) -> Callable[[Writer, dict[str, int]], None]:
    def fill(writer: Writer, channels: dict[str, int]) -> None:
        writer.add_message(channels[EVENT], 1, MARK, 1)
        for _ in range(entries):
            writer.add_metadata(PROVENANCE, each)

    return fill


MARK = json.dumps({"level": 2, "name": "mark", "message": "x"}).encode()
LONG = b'{"level": 2, "name": "mark", "message": "' + 40_000_000 * b"y" + b'"}'
NESTED = b'{"level": 2, "name": "mark", "message": [' + 15_000_000 * b"[]," + b"[]]}"
RECORDINGS: dict[str, Callable[[Writer, dict[str, int]], None]] = {
    "many ticks": many(TICK, b'{"now_ns": 1}', 1_200_000),
    "many frames": many(FRAME, b"{}", 1_500_000),
    "a long message": many(EVENT, LONG, 1),
    "a message of many lists": many(EVENT, NESTED, 1),
    "long metadata": metadata(1, {str(number): "" for number in range(300_000)}),
    "much metadata": metadata(20_000, {"version": "1"}),
}


def write(path: Path, fill: Callable[[Writer, dict[str, int]], None]) -> None:
    """Write a recording of one chunk."""
    with path.open("wb") as file:
        writer = Writer(file, 1 << 30, compression=CompressionType.ZSTD, index_types=IndexType.NONE)
        writer.start(profile="telepulse")
        channels = {
            topic: writer.register_channel(topic, "json", _schema(writer, name, schema))
            for topic, (name, schema) in SCHEMAS.items()
        }
        fill(writer, channels)
        writer.finish()


def _schema(writer: Writer, name: str, schema: Any) -> int:
    return writer.register_schema(name, "jsonschema", json.dumps(schema).encode())


@pytest.mark.skipif(sys.platform != "linux", reason="memory as Linux states it")
@pytest.mark.timeout(4 * PATIENCE_S)
@pytest.mark.parametrize("fill", RECORDINGS.values(), ids=RECORDINGS)
def test_a_recording_is_refused_before_it_is_unpacked(
    fill: Callable[[Writer, dict[str, int]], None], tmp_path: Path
) -> None:
    write(tmp_path / "run.mcap", fill)
    for name, (command, *options) in COMMANDS.items():
        words = (command, options.pop(0)) if name == "study" else (command,)
        line = refused(tmp_path, *words, "run.mcap", *options)
        assert "run.mcap" in line, name
