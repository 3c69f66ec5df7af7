import errno
import itertools
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from serial import serial_for_url
from serial.rfc2217 import PortManager

from protocol.config.scene import validate
from protocol.errors import SourceError
from pulse_sensors.sensor import open_sensor
from pulse_sensors.serial_port import SerialPort, SerialScene
from telepulse.emulators import PtyPort
from telepulse.emulators.sensor_board import binary, timed_line
from tests.support.nodes import free_address, read_json, run
from tests.support.sample_blocks import await_log, forces, received
from tests.support.waiting import PATIENCE_S, until


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


def test_a_socket_is_read_and_its_end_is_logged(logged: list[str]) -> None:
    enough = threading.Event()

    def serve(connection: socket.socket, over: threading.Event) -> None:
        while not enough.wait(0.01) and not over.is_set():
            connection.sendall(b"0.25\n" * 10)

    with server(serve) as address, opened(scene(f"socket://{address}")) as sensor:
        assert set(forces(received(sensor, 100))) == {0.25}
        enough.set()
        await_log(sensor, logged)
        assert logged[0].startswith(f"socket://{address} has gone: ")


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
    assert f"{found['samples']['sent']} samples beyond 20 N" in "; ".join(found["faults"])


@pytest.mark.filterwarnings("ignore:set:DeprecationWarning")  # pyserial's own
def test_rfc2217_is_read() -> None:
    def serve(connection: socket.socket, over: threading.Event) -> None:
        with serial_for_url("loop://", timeout=0) as device:
            # The manager writes replies of its own.
            manager = PortManager(device, SimpleNamespace(write=connection.sendall))
            connection.settimeout(0.02)
            while not over.is_set():
                try:
                    list(manager.filter(connection.recv(1024)))
                except TimeoutError:
                    connection.sendall(b"".join(manager.escape(b"0.25\n" * 20)))
                except OSError:
                    return

    with server(serve) as address, opened(scene(f"rfc2217://{address}")) as sensor:
        assert set(forces(received(sensor, 100))) == {0.25}


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
    with pytest.raises(SourceError) as caught:
        SerialPort(scene(port)).open()
    assert str(caught.value).startswith(f"{port}: cannot be opened: {reason}")
    assert "\n" not in str(caught.value)


def test_a_closed_sensor_releases_its_port() -> None:
    with closing(PtyPort(None)) as board:
        for _ in range(3):
            before = len(os.listdir("/proc/self/fd"))
            open_sensor(scene(board.path), Path()).close()
            assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.parametrize("read_at", [57_600, 230_400])
@pytest.mark.parametrize("framing", ["text", "binary"])
def test_a_wrong_baud_rate_gives_no_samples_and_is_counted(framing: str, read_at: int) -> None:
    encode = binary("float32") if framing == "binary" else timed_line
    sent = b"".join(encode([[0.3 + 1e-3 * number]], 1_000 * number) for number in range(400))
    noise = misread(sent, 115_200, read_at)
    with closing(PtyPort(None)) as board, opened(scene(board.path, framing=framing)) as sensor:
        found = []
        for begin in range(0, len(noise), 256):
            board.write(noise[begin : begin + 256])
            time.sleep(1e-3)
            found += sensor.poll()
        until(lambda: sensor.poll() == [] and sensor.rejected.total() > 0)
        assert found == []
        assert sensor.faults() == [f"no sample came from {board.path}"]


def misread(data: bytes, sent_at: int, read_at: int) -> bytes:
    """Return the bytes that a UART (8N1) reads of bytes sent at another rate."""
    bits = [bit for byte in data for bit in (0, *((byte >> i) & 1 for i in range(8)), 1)]
    step, at, found = sent_at / read_at, 0.0, bytearray()
    while at + 10 * step < len(bits):
        if bits[int(at)]:
            at += step / 16
        else:
            found.append(sum(bits[int(at + (i + 1.5) * step)] << i for i in range(8)))
            at += 9.5 * step
    return bytes(found)
