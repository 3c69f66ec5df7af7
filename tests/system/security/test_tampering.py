"""Bytes that are altered, replayed or reflected on the way between two nodes with keys."""

import contextlib
import socket
import socketserver
import threading
import time
from collections.abc import Callable
from pathlib import Path

import zmq

from protocol import sockets
from protocol.security.authenticator import Authenticator
from protocol.sockets import Context
from protocol.wire.messages import Hello, encode_control
from tests.support.hostile_peers import port_of
from tests.support.keyring import Keyring
from tests.support.live_display import await_state, await_status, subscribe
from tests.support.middleman import (
    MESSAGE_BYTES,
    Alter,
    Middleman,
    Once,
    flip_a_bit,
    middleman,
    twice,
)
from tests.support.nodes import RADIAL, assert_accounted, free_address, process, read_json
from tests.support.waiting import PATIENCE_S, until

HANDSHAKE_BYTES = 800
QUIET_S = 0.3
ALTERATIONS, COUNTED_WITHIN_S = 6, 5.0
# Causes that a display counts when altered bytes get as far as its messages.
ACCEPTED = {"truncated", "not_msgpack", "version", "malformed", "not_finite", "duplicate"}


def test_altered_and_replayed_messages_are_refused_and_the_link_recovers(
    context: Context, keyring: Keyring, tmp_path: Path
) -> None:
    address, behind, telemetry = free_address(), free_address(), free_address()
    sensed, played = tmp_path / "sensed.json", tmp_path / "played.json"
    keys = ("--key", keyring.path("finger"), "--peer", keyring.path("wrist", "pub"))
    display = (
        *(str(RADIAL), "--connect", address, "--no-screen", "--telemetry", telemetry, *keys),
        *("--json", str(played)),
    )
    sensing = (str(RADIAL), "--bind", behind, "--key", keyring.path("wrist"), "--json", str(sensed))
    reader = subscribe(context, telemetry)
    with (
        middleman(port_of(address), port_of(behind)) as data,
        middleman(port_of(address) + 1, port_of(behind) + 1) as control,
        process("display_node.cli", *display) as finger,
        process("sensing_node.cli", *sensing) as wrist,
    ):
        await_state(reader, "playing")
        for alter, cause in ((flip_a_bit, "not_authentic"), (twice, "replayed")):
            alter_until(data, alter, reader, cause)
            # A new connection may deliver before a status has named the interruption.
            await_state(reader, "playing")
        for alter in (flip_a_bit, twice):
            connections = len(control.recorded)
            alter_one(control, "up", alter)
            until(lambda made=connections: sent_since(control, made) > HANDSHAKE_BYTES)
        replay(data, behind)
        wrist.terminate()
        assert wrist.wait(PATIENCE_S) == 0
        await_state(reader, "ended")
        finger.terminate()
        assert finger.wait(PATIENCE_S) == 0
    ours, theirs = read_json(played), read_json(sensed)
    assert_accounted(ours["samples"])
    assert ours["samples"]["lost"] > 0
    assert not ACCEPTED & set(ours["rejected"])
    assert not ACCEPTED & set(theirs["rejected"])
    assert theirs["rejected"]["not_authentic"] >= 1
    assert theirs["rejected"]["replayed"] >= 1


def alter_one(between: Middleman, way: str, alter: Alter) -> None:
    """Alter one message."""
    once = Once(alter)
    setattr(between, way, once)
    until(lambda: once.done)
    setattr(between, way, None)


def alter_until(between: Middleman, alter: Alter, reader: zmq.Socket, cause: str) -> None:
    """Alter messages until a status counts one; the display may close the connection first."""
    for _ in range(ALTERATIONS):
        alter_one(between, "down", alter)
        until_s = time.monotonic() + COUNTED_WITHIN_S
        while time.monotonic() < until_s:
            if cause in await_status(reader, lambda _: True).summary["rejected"]:
                return
    raise AssertionError(f"no {cause} after {ALTERATIONS} messages")


def sent_since(between: Middleman, connections: int) -> int:
    """Return the number of bytes that were sent up over the later connections."""
    return sum(len(up) for _, up in between.recorded[connections:])


def replay(between: Middleman, onto: str) -> None:
    """Send a node all bytes of an allowed display; it must send nothing of the stream."""
    down, up = max(between.recorded, key=lambda record: len(record[0]))
    received = b""
    with socket.create_connection(("127.0.0.1", port_of(onto)), timeout=2) as again:
        again.sendall(bytes(up))
        with contextlib.suppress(OSError):
            while chunk := again.recv(1 << 16):
                received += chunk
    # A greeting and a WELCOME; a READY is for a peer with the secret key.
    assert len(received) < 400 < len(down)


def test_bytes_that_are_replayed_or_reflected_to_a_display_are_refused(
    context: Context, keyring: Keyring
) -> None:
    bound, address = free_address(), free_address()
    authenticator = Authenticator(context, keyring.server())
    data = sockets.bind(context, zmq.PUB, bound, authenticator)
    with middleman(port_of(address), port_of(bound)) as between:
        listener = subscribed(context, address, keyring)

        def received() -> bool:
            authenticator.poll(time.perf_counter_ns())
            sockets.send(data, b"secret")
            return bool(listener.poll(0))

        until(received)
        until(lambda: received() and len(between.recorded[0][0]) > 2 * HANDSHAKE_BYTES)
        ((down, _),) = between.recorded
    for answer in (lambda _: bytes(down), lambda request: request):
        with Reflector(answer) as server:
            victim = subscribed(context, server.address, keyring)
            until(lambda server=server: server.answers >= 1)
            assert not victim.poll(300)
            victim.close(0)


def test_messages_that_are_joined_on_the_way_are_refused(
    context: Context, keyring: Keyring, tmp_path: Path
) -> None:
    address, behind, sensed = free_address(), free_address(), tmp_path / "sensed.json"
    arguments = (str(RADIAL), "--bind", behind, "--key", keyring.path("wrist"))
    control = sockets.control_address(address)
    with (
        middleman(port_of(control), port_of(behind) + 1) as between,
        process("sensing_node.cli", *arguments, "--json", str(sensed)) as wrist,
    ):
        peer = sockets.connect(context, zmq.DEALER, control, keyring.client("finger"))

        def answered() -> bool:
            sockets.send(peer, encode_control(Hello("d" * MESSAGE_BYTES)))
            return bool(peer.poll(20) and peer.recv())

        until(answered)
        between.up = join = Once(with_a_further_part)
        until(lambda: answered() and join.done)
        between.up = None
        until(answered)
        wrist.terminate()
        assert wrist.wait(PATIENCE_S) == 0
    assert read_json(sensed)["rejected"] == {"malformed": 1}


def with_a_further_part(data: bytes) -> bytes:
    """Set the flag of a ZMTP frame that more of its message follows."""
    return bytes([data[0] | 1]) + data[1:]


def test_a_nodes_bytes_reflected_to_it_get_no_frame(context: Context, keyring: Keyring) -> None:
    authenticator = Authenticator(context, keyring.server())
    address = free_address()
    data = sockets.bind(context, zmq.PUB, address, authenticator)
    received, end_s = b"", time.monotonic() + QUIET_S
    with socket.create_connection(("127.0.0.1", port_of(address)), timeout=0.02) as mirror:
        while time.monotonic() < end_s:
            authenticator.poll(time.perf_counter_ns())
            sockets.send(data, b"secret" * 100)
            with contextlib.suppress(TimeoutError):
                back = mirror.recv(1 << 16)
                mirror.sendall(back)
                received += back
    # Only a greeting, without data of the stream.
    assert 0 < len(received) < 100
    until(
        lambda: (
            authenticator.poll(time.perf_counter_ns()) or authenticator.rejected["handshake"] == 1
        )
    )


def subscribed(context: Context, address: str, keyring: Keyring) -> sockets.Socket:
    listener = sockets.connect(context, zmq.SUB, address, keyring.client("finger"))
    listener.subscribe(b"")
    return listener


class Reflector(socketserver.ThreadingTCPServer):
    """Server that answers each request with `answer(request)`."""

    daemon_threads = False

    def __init__(self, answer: Callable[[bytes], bytes]) -> None:
        super().__init__(("127.0.0.1", 0), _Answer)
        self.answer = answer
        self.answers = 0
        self.address = f"tcp://127.0.0.1:{self.server_address[1]}"
        self._thread = threading.Thread(target=self.serve_forever, args=(0.02,))
        self._thread.start()

    def __exit__(self, *error: object) -> None:
        self.shutdown()
        self._thread.join()
        super().__exit__(*error)


class _Answer(socketserver.BaseRequestHandler):
    def handle(self) -> None:
        assert isinstance(self.server, Reflector)
        with contextlib.suppress(OSError):
            self.request.settimeout(0.5)
            while request := self.request.recv(1 << 16):
                self.request.sendall(self.server.answer(request))
                self.server.answers += 1
