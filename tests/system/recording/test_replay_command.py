import csv
import errno
import json
import os
import resource
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from telepulse.recording.mcap_reader import RecordingReader
from telepulse.telemetry.schema import FRAME, STATUS, TICK
from tests.support.log_lines import unusual
from tests.support.nodes import RADIAL, assert_accounted, free_address, process, read_json, run

MODULE = "telepulse"
PATIENCE_S = 60.0


@contextmanager
def recorded_display(
    path: Path,
    address: str,
    scene: str = str(RADIAL),
    room_bytes: int = resource.RLIM_INFINITY,
) -> Iterator["subprocess.Popen[str]"]:
    """Run a display that records, from when its recorder runs; its summary is beside the file.

    room_bytes: limit of the size of its files, as on a small disk.
    """
    arguments = (scene, "--connect", address, "--no-screen", "--once", "--seconds", "40")
    arguments += ("--record", str(path), "--json", str(path.with_suffix(".json")))
    with process("display_node.cli", *arguments) as display:
        limits = (room_bytes, resource.RLIM_INFINITY)
        resource.prlimit(display.pid, resource.RLIMIT_FSIZE, limits)
        while not path.exists():
            assert display.poll() is None
            time.sleep(0.05)
        yield display


def felt_and_recorded(
    path: Path, address: str, source: tuple[str, ...]
) -> tuple[dict[str, list[dict[str, object]]], dict[str, object]]:
    """Record a source at a display; return the messages by topic and the display's summary."""
    with recorded_display(path, address) as display, process(*source) as sensing:
        output, errors = display.communicate(timeout=PATIENCE_S)
        assert (display.returncode, unusual(errors)) == (0, ""), output
        sensing.communicate(timeout=PATIENCE_S)
        assert sensing.returncode == 0
    reader, topics = RecordingReader(path), {}
    for message in reader:
        topics.setdefault(message.topic, []).append(message.fields)
    assert reader.whole
    return topics, read_json(path.with_suffix(".json"))


def samples(frames: list[dict[str, object]]) -> tuple[int, NDArray[np.float32]]:
    """Return the number of the first sample, and all samples."""
    ordered = sorted(frames, key=lambda fields: fields["first_sample"])
    values = [np.array(fields["force_n"], "<f4") for fields in ordered]
    return ordered[0]["first_sample"], np.concatenate(values)


def test_a_recording_played_again_gives_the_same_samples_bit_by_bit(tmp_path: Path) -> None:
    address, first, again = free_address(), tmp_path / "first.mcap", tmp_path / "again.mcap"
    sensing = ("sensing_node.cli", str(RADIAL), "--bind", address, "--seconds", "2.5", "--quiet")
    topics, summary = felt_and_recorded(first, address, sensing)
    recorded = RecordingReader(first)
    assert len(list(recorded))
    assert len(topics[FRAME]) == summary["frames"]["received"]
    assert len(topics[TICK]) == summary["loop"]["ticks"]
    assert topics[STATUS][-1]["final"]
    (made,) = recorded.provenance
    assert json.loads(made["command"])[1:3] == [str(RADIAL), "--connect"]
    assert json.loads(made["scene"])["path"] == str(RADIAL)
    assert summary["provenance"]["effective"] == json.loads(made["effective"])
    at, sensed_n = samples(topics[FRAME])
    assert at + len(sensed_n) == 2500

    replay = (MODULE, "replay", str(first), "--bind", address)
    replayed, summary = felt_and_recorded(again, address, replay)
    at, played_n = samples(replayed[FRAME])
    assert summary["samples"]["lost"] == 0
    assert at + len(played_n) == len(sensed_n)
    assert len(played_n) > 500
    assert played_n.tobytes() == sensed_n[at:].tobytes()

    tables = tmp_path / "tables"
    result = run(MODULE, "export", str(first), "--to", "csv", "--out", str(tables))
    assert result.returncode == 0, result.stderr
    with (tables / "samples.csv").open(encoding="utf-8", newline="") as file:
        exported = [float(row["force_0_n"]) for row in csv.DictReader(file)]
    np.testing.assert_array_equal(np.array(exported, "<f4"), sensed_n)
    lines = (tables / "ticks.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == len(topics[TICK]) + 1
    assert run(MODULE, "export", str(first), "--out", str(tables), "--to", "csv").returncode == 2


def test_a_full_disk_under_the_recorder_does_not_disturb_the_display(path: Path) -> None:
    address, room_bytes = free_address(), 20_000
    sensing = ("sensing_node.cli", str(RADIAL), "--bind", address, "--seconds", "2.5", "--quiet")
    with recorded_display(path, address, room_bytes=room_bytes) as display, process(*sensing):
        _, errors = display.communicate(timeout=PATIENCE_S)
    assert display.returncode == 1
    assert os.strerror(errno.EFBIG) in errors
    assert "messages could not be written" in errors
    result = read_json(path.with_suffix(".json"))
    assert_accounted(result["samples"])
    assert result["samples"]["lost"] == 0
    assert result["samples"]["sent"] > 500
    assert result["faults"] == []
    assert path.stat().st_size <= room_bytes
