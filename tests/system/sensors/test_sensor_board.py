"""An emulated board, a sensing node and a display as processes, on a real pseudo-terminal."""

import itertools
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from protocol.faults import notes_of
from protocol.wire.messages import Frame, decode_frame
from tests.support.nodes import RADIAL, assert_accounted, process, read_json
from tests.support.sensing_client import Client
from tests.support.waiting import PATIENCE_S, until

BOARD, SENSING, DISPLAY = "telepulse", "sensing_node.cli", "display_node.cli"


def scene_file(folder: Path) -> Path:
    path = folder / "bench.toml"
    path.write_text(
        f'[sensing.source]\nkind = "serial"\nport = "{folder}/board"\nframing = "binary"\n'
        'rate = "1 kHz"\nunit = "N"\n'
        + "[display"
        + RADIAL.read_text(encoding="utf-8").partition("[display")[2],
        encoding="utf-8",
    )
    return path


def board_command(folder: Path, *options: str) -> tuple[str, ...]:
    return (BOARD, "emulate", "sensor", "radial", "--link", str(folder / "board"), *options)


@contextmanager
def board(folder: Path, *options: str) -> Iterator["subprocess.Popen[str]"]:
    """Run a board that has printed its table."""
    with process(*board_command(folder, *options)) as child:
        assert child.read_line(3 * PATIENCE_S) == "[sensing.source]"
        yield child


def frames(client: Client, count: int) -> list[Frame]:
    return [decode_frame(client.data.recv()) for _ in range(count)]


def test_a_boards_pulse_reaches_a_display_and_every_sample_is_counted(
    tmp_path: Path, address: str
) -> None:
    scene = str(scene_file(tmp_path))
    sensed, felt = tmp_path / "sensing.json", tmp_path / "display.json"
    display_command = (DISPLAY, scene, "--connect", address, "--once", "--json", str(felt))
    command = (SENSING, scene, "--bind", address, "--seconds", "4", "--json", str(sensed))
    with (
        board(tmp_path),
        process(*display_command) as display,
        process(*command) as sensing,
    ):
        assert sensing.wait(60) == 0
        assert display.wait(60) == 0
    sensing_summary, display_summary = read_json(sensed), read_json(felt)
    samples = display_summary["samples"]
    assert_accounted(samples)
    assert samples["sent"] + samples["before_joining"] == sensing_summary["samples"]["sent"] > 2000
    assert samples["lost"] == 0
    assert sensing_summary["faults"] == display_summary["faults"] == []
    assert sensing_summary["notes"] == display_summary["notes"] == []
    assert set(sensing_summary["rejected"]) <= {"partial"}
    assert display_summary["rejected"] == {}


def test_an_unplugged_cable_is_reported_and_missed_samples_count_as_lost(
    tmp_path: Path, address: str, client: Client
) -> None:
    summary = tmp_path / "sensing.json"
    link = tmp_path / "board"
    arguments = (SENSING, str(scene_file(tmp_path)), "--bind", address, "--json", str(summary))
    with board(tmp_path) as plugged, process(*arguments) as sensing:
        client.join()
        before = frames(client, 50)
        plugged.send_signal(signal.SIGTERM)
        plugged.wait(20)
        until(lambda: not link.exists())
        with board(tmp_path, "--seed", "2"):
            jumped = before[-1:]
            while jumped[-1].first_sample - before[-1].first_sample < 1000:
                jumped += frames(client, 1)
            sensing.send_signal(signal.SIGTERM)
            _, errors = sensing.communicate(timeout=20)
    assert f"{link} has gone: " in errors
    assert f"{link} is back" in errors
    found = read_json(summary)
    assert found["faults"] == []
    went, missing, *_ = (note.text for note in notes_of(found))
    assert went.startswith(f"{link} was gone 1 time, for ")
    assert missing.endswith(f" samples missing from {link}")
    gaps = [
        later.first_sample - earlier.first_sample - len(earlier.values)
        for earlier, later in itertools.pairwise(jumped)
    ]
    assert max(gaps) > 100
    for (earlier, later), gap in zip(itertools.pairwise(jumped), gaps, strict=True):
        passed_ns = later.t_first_ns - earlier.t_first_ns
        samples = len(earlier.values) + gap
        assert passed_ns == pytest.approx(samples * 1e6, rel=0.5, abs=300e6)
