import errno
import itertools
import os
import socket
import threading
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
