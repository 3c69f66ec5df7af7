import errno
import itertools
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from protocol.config.scene import validate
from protocol.errors import SourceError
from protocol.faults import notes_of
from pulse_sensors.sensor import open_sensor
from pulse_sensors.serial_port import SerialPort, SerialScene
from telepulse.emulators import PtyPort
from tests.support.nodes import free_address, read_json, run
from tests.support.refusals import refusal_of
from tests.support.sample_blocks import forces, received
from tests.support.waiting import PATIENCE_S


def scene(port: object, **keys: object) -> SerialScene:
    table = {"kind": "serial", "port": str(port), "framing": "text", "rate": "1 kHz", "unit": "N"}
    return validate(table | keys, SerialScene, "scene")


def opened(scene: SerialScene) -> Any:
    return closing(open_sensor(scene, Path()))


@contextmanager
def server(serve: Callable[[socket.socket, threading.Event], None]) -> Iterator[str]:
    """Run a TCP server for one client."""
    over = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listening:
        listening.settimeout(PATIENCE_S)

        def run() -> None:
            with listening.accept()[0] as connection:
                serve(connection, over)

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield f"127.0.0.1:{listening.getsockname()[1]}"
        finally:
            over.set()
            thread.join(PATIENCE_S)


def test_a_pseudo_terminal_is_read_by_one_sensor_only_and_garbage_is_counted() -> None:
    with closing(PtyPort(None)) as board, opened(scene(board.path)) as sensor:
        board.write(b"\n0.1\n0.2\n0.3\n")
        assert forces(received(sensor, 3)) == [0.1, 0.2, 0.3]
        assert (sensor.faults(), sensor.rejected) == ([], {})
        with pytest.raises(SourceError, match="cannot be opened"):
            SerialPort(scene(board.path)).open()
        board.write(b"\n0.1\nx\n\xff\xfe\n0.2\n")
        assert forces(received(sensor, 2)) == [0.1, 0.2]
        assert sensor.rejected == {"not_a_number": 2}
        assert sensor.faults() == [f"2 samples missing from {board.path}"]


def test_a_sensing_node_reports_the_wrong_unit_once(tmp_path: Path) -> None:
    def serve(connection: socket.socket, over: threading.Event) -> None:
        for force in itertools.cycle(range(300, 350)):
            if over.wait(5e-3):
                return
            with suppress(OSError):
                connection.sendall(b"%d\n" % force)

    summary, scene_file = tmp_path / "summary.json", tmp_path / "scene.toml"
    with server(serve) as address:
        scene_file.write_text(
            f'[sensing.source]\nkind = "serial"\nport = "socket://{address}"\nframing = "text"\n'
            'rate = "200 Hz"\nunit = "N"\n',
            encoding="utf-8",
        )
        arguments = ("--bind", free_address(), "--seconds", "2", "--json", str(summary))
        result = run("sensing_node.cli", str(scene_file), *arguments)
    assert result.returncode == 0, result.stderr
    text = "beyond 20 N, which no pulse reaches: check unit and scale in"
    assert " ".join(result.stderr.split()).count(text) == 1
    found = read_json(summary)
    assert f"{found['samples']['sent']} samples beyond 20 N" in "; ".join(map(str, notes_of(found)))


def sent_at(lines_per_s: int, *kinds: tuple[float, bytes]) -> Callable[..., None]:
    """Return what serves lines at a rate, each kind for its time, the last one to the end."""

    def serve(connection: socket.socket, over: threading.Event) -> None:
        count = itertools.count()
        begin_s = time.monotonic()
        while not over.wait(1 / lines_per_s):
            passed_s = time.monotonic() - begin_s
            line = next((line for until_s, line in kinds if passed_s < until_s), kinds[-1][1])
            stamp = b"%.2f" % passed_s
            with suppress(OSError):
                force_n = b"%.3f" % (0.3 + next(count) % 7 * 0.01)
                connection.sendall(line.replace(b"%t", stamp).replace(b"%f", force_n) + b"\r\n")

    return serve


def written_scene(folder: Path, address: str, keys: str) -> Path:
    path = folder / "scene.toml"
    path.write_text(
        f'[sensing.source]\nkind = "serial"\nport = "socket://{address}"\nframing = "text"\n'
        'unit = "N"\n' + (keys if "rate" in keys else f'{keys}\nrate = "50 Hz"\n'),
        encoding="utf-8",
    )
    return path


def sent_by_node(folder: Path, serve: Callable[..., None], keys: str, seconds: float) -> Any:
    """Run a sensing node on a served sensor; return its words in one line, and its summary."""
    summary = folder / "summary.json"
    with server(serve) as address:
        scene = written_scene(folder, address, keys)
        arguments = ("--bind", free_address(), "--seconds", str(seconds), "--json", str(summary))
        result = run("sensing_node.cli", str(scene), *arguments)
    assert result.returncode == 0, result.stderr
    return " ".join(result.stderr.split()), read_json(summary)


def test_a_sensing_node_quotes_lines_without_a_sample_and_each_new_cause(tmp_path: Path) -> None:
    serve = sent_at(50, (4, b"ready\x07"), (9, b"Force: 12 kg"))
    words, found = sent_by_node(tmp_path, serve, "", 8)
    unread = "sends, but no sample can be read: the line "
    assert words.count(unread) == 2
    assert unread + r"'ready\x07' is no text: set framing" in words
    assert unread + "'Force: 12 kg' is in kg, the scene says unit = \"N\": set unit" in words
    assert "'Force: 12 kg'" in "; ".join(map(str, notes_of(found)))


def test_a_sensing_node_reads_labels_units_and_coarse_times(tmp_path: Path) -> None:
    keys = 'device_time = "s"\ncolumn = "F"'
    words, found = sent_by_node(tmp_path, sent_at(50, (9, b"%t BPM=61 F: %f N")), keys, 3)
    assert found["samples"]["sent"] > 100
    assert found["rejected"].keys() <= {"partial"}
    assert "WARNING" not in words
    # Too coarse for such a rate.
    keys = 'device_time = "s"\nrate = "1 kHz"'
    words, found = sent_by_node(tmp_path, sent_at(500, (9, b"%t %f\r\n%t %f")), keys, 3)
    assert found["samples"]["sent"] > 1000
    assert found["rejected"].keys() <= {"partial"}
    assert words.count("the device's times step by 10 ms, which is too coarse for") == 1


def test_bench_quotes_lines_without_a_sample(tmp_path: Path) -> None:
    with server(sent_at(50, (9, b"Force 0.3"))) as address:
        scene = written_scene(tmp_path, address, "")
        tables = tmp_path / "tables.json"
        options = ("--only", "sensing", "--seconds", "1", "--json", str(tables))
        result = run("telepulse", "bench", str(scene), *options)
    assert result.returncode == 1
    (row,) = read_json(tables)["chapters"][0]["tables"][0]["rows"]
    for words in (row["why"], result.stderr):
        assert "the line 'Force 0.3' has 'Force' where a number" in " ".join(words.split())


@pytest.mark.parametrize(
    ("port", "reason"),
    [
        ("{}/ttyACM0", f"{os.strerror(errno.ENOENT)}; ports here: "),
        *((port, "") for port in ("socket://127.0.0.1:1", "guitar://x", "socket://nowhere", "/")),
    ],
)
def test_a_port_that_cannot_be_opened_is_refused_in_one_line(
    tmp_path: Path, port: str, reason: str
) -> None:
    port = port.format(tmp_path)
    line = refusal_of(SourceError, lambda: SerialPort(scene(port)).open())
    assert line.startswith(f"{port}: cannot be opened: {reason}")
