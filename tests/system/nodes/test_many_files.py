"""What waits for descriptors, where a node with many displays has left those above 1 023."""

import io
import os
import socket
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest
import zmq

from display_node.reception.connection import Connection
from display_node.reception.reachability import ConnectionRequest
from protocol import sockets
from protocol.config.scene import validate
from protocol.host.descriptors import await_readable
from protocol.host.output import QueuedStream
from protocol.sockets import Context
from pulse_drives.stepdir.line import BoardLine
from pulse_drives.tmcl.line import DATAGRAM_BYTES
from pulse_sensors.sensor import open_sensor
from pulse_sensors.serial_port import SerialScene
from telepulse.emulators import PtyPort
from telepulse.emulators.tmcl import EmulatedSerialLine, EmulatedTmclModule
from telepulse.experiment.subjects import Keyboard
from tests.support.drive_benches import actuator_of, emulated_motor, real_bench, tmcl_scene
from tests.support.many_files import SELECT_TAKES, many_files
from tests.support.sample_blocks import forces, received
from tests.support.waiting import PATIENCE_S, until

pytestmark = pytest.mark.smoke
GET_AXIS_PARAMETER = 6
FOREVER_NS = 3_600_000_000_000


@pytest.fixture(autouse=True)
def crowded() -> Iterator[None]:
    with many_files():
        yield


def sensor_of(port: str) -> SerialScene:
    keys = {"kind": "serial", "port": port, "framing": "text", "rate": "1 kHz", "unit": "N"}
    return validate(keys, SerialScene, "scene")


def test_a_sensor_on_a_device_is_read() -> None:
    with closing(PtyPort(None)) as board:
        assert board.fileno() >= SELECT_TAKES
        with closing(open_sensor(sensor_of(str(board.path)), Path())) as sensor:
            board.write(b"\n0.1\n0.2\n")
            assert forces(received(sensor, 2)) == [0.1, 0.2]
            assert sensor.faults() == []


def test_a_sensor_on_a_socket_is_read_to_its_end(logged: list[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        name = f"socket://127.0.0.1:{listening.getsockname()[1]}"
        with closing(open_sensor(sensor_of(name), Path())) as sensor:
            with listening.accept()[0] as connection:
                connection.sendall(b"\n0.1\n0.2\n")
                assert forces(received(sensor, 2)) == [0.1, 0.2]
            until(lambda: sensor.poll() or logged)
    assert logged[0] == f"{name} has gone: its other end is closed"


def test_a_request_to_connect_has_its_result() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        place = f"tcp://127.0.0.1:{listening.getsockname()[1]}"
        with closing(ConnectionRequest(place, 0)) as accepted:
            until(lambda: accepted.result() is not None)
            assert accepted.result() == 0
    with closing(ConnectionRequest(place, 0)) as refused:
        until(lambda: refused.result() is not None)
        assert refused.result()


def test_a_wait_on_sockets_ends_at_a_message(context: Context) -> None:
    near = sockets.bind(context, zmq.PAIR, "tcp://127.0.0.1:*")
    far = sockets.connect(context, zmq.PAIR, str(near.getsockopt_string(zmq.LAST_ENDPOINT)))
    waited_for = sockets.descriptors([near])
    assert min(waited_for.numbers) >= SELECT_TAKES
    sockets.send(far, b"x")
    while not (messages := list(sockets.receive_parts(near))):
        assert sockets.wait_on_descriptors(waited_for, FOREVER_NS)
    assert messages == [b"x"]
    sockets.send(far, b"y")
    sockets.wait_readable([near], FOREVER_NS)


def test_a_pressing_display_reads_its_further_connections(context: Context, address: str) -> None:
    with closing(Connection(context, [address], 1, None, turns=2)) as connection:
        assert min(connection.descriptors.numbers) >= SELECT_TAKES
        assert list(connection.control_messages()) == []


def test_what_a_full_pipe_holds_up_is_written() -> None:
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    filled = 0
    with suppress(BlockingIOError):
        while True:
            filled += os.write(writing, bytes(4_096))
    stream = QueuedStream(io.TextIOWrapper(io.FileIO(writing, "w", closefd=False), "utf-8"))
    stream.write("held up\n")
    time.sleep(0.05)
    text = b""
    while not text.endswith(b"held up\n"):
        text += os.read(reading, 65_536)
    stream.finish()
    assert len(text) == filled + len("held up\n")
    os.close(reading)
    os.close(writing)


def test_keys_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    reading, writing = os.pipe()
    with os.fdopen(reading) as standard_input, os.fdopen(writing, "wb", 0) as keys:
        monkeypatch.setattr(sys, "stdin", standard_input)
        with Keyboard() as keyboard:
            assert keyboard.key(0.0) is None
            keys.write(b"A")
            assert keyboard.key(60.0) == "a"


def test_a_board_and_the_line_to_it_are_read() -> None:
    with real_bench("stepdir") as bench:
        line = BoardLine(bench.scene, Counter())
        line.attach()
        # The board's greeting answers a command, so both ends have read.
        assert line.greet(PATIENCE_S).protocol
        line.detach()
        assert line.lost == "closed"


def test_an_emulated_module_is_asked() -> None:
    with closing(PtyPort(None)) as port:
        scene = tmcl_scene(port=str(port.path))
        module = EmulatedTmclModule(
            scene, emulated_motor(scene, actuator_of("tmcl"), time.perf_counter_ns())
        )
        line = EmulatedSerialLine(module, port)
        number = os.open(port.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        os.write(number, request(scene.module, GET_AXIS_PARAMETER))
        until(lambda: [line.serve(0.001), await_readable(number, 0.0)][1])
        assert len(os.read(number, 64)) == DATAGRAM_BYTES
        os.close(number)


def request(module: int, command: int) -> bytes:
    """Return a datagram of TMCL."""
    data = bytes([module, command, 1, 0, 0, 0, 0, 0])
    return data + bytes([sum(data) % 256])
