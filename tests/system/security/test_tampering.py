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
from protocol.wire.telemetry import Status
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
STRIKES, STRUCK_WITHIN_S = 6, 5.0
# What a display counts when bytes that were not sent so get as far as its messages.
BELIEVED = {"truncated", "not_msgpack", "version", "malformed", "not_finite", "duplicate"}


def port(address: str) -> int:
    return int(address.rpartition(":")[2])


def rejected(cause: str) -> Callable[[Status], bool]:
    return lambda status: cause in status.summary["rejected"]


def test_altered_and_replayed_messages_are_refused_and_the_link_recovers(
    context: Context, tmp_path: Path
) -> None:
    keyring = Keyring(tmp_path / "keys")
    keyring.allow("finger")
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
        middleman(port(address), port(behind)) as data,
        middleman(port(address) + 1, port(behind) + 1) as control,
        process("display_node.cli", *display) as finger,
        process("sensing_node.cli", *sensing) as wrist,
    ):
        await_state(reader, "playing")
        for alter, cause in ((flip_a_bit, "not_authentic"), (twice, "replayed")):
            strike_until(data, alter, reader, cause)
            # A new connection may deliver before a status has named the interruption.
            await_state(reader, "playing")
        for alter in (flip_a_bit, twice):
            connections = len(control.recorded)
            strike(control, "up", alter)
            until(lambda made=connections: said_since(control, made) > HANDSHAKE_BYTES)
        replay(data, behind)
        wrist.terminate()
        assert wrist.wait(PATIENCE_S) == 0
        await_state(reader, "ended")
        finger.terminate()
        assert finger.wait(PATIENCE_S) == 0
    ours, theirs = read_json(played), read_json(sensed)
    assert_accounted(ours["samples"])
    assert ours["samples"]["lost"] > 0
    assert not BELIEVED & set(ours["rejected"])
    assert not BELIEVED & set(theirs["rejected"])
    assert theirs["rejected"]["not_authentic"] >= 1
    assert theirs["rejected"]["replayed"] >= 1


def strike(between: Middleman, way: str, alter: Alter) -> None:
    """Have one message altered."""
    once = Once(alter)
    setattr(between, way, once)
    until(lambda: once.done)
    setattr(between, way, None)


def strike_until(between: Middleman, alter: Alter, reader: zmq.Socket, cause: str) -> None:
    """Have messages altered until a status counts it: one may be on a connection that the
    display closes at that moment, as a second one has taken its place."""
    for _ in range(STRIKES):
        strike(between, "down", alter)
        until_s = time.monotonic() + STRUCK_WITHIN_S
        while time.monotonic() < until_s:
            if rejected(cause)(await_status(reader, lambda _: True)):
                return
    raise AssertionError(f"no {cause} after {STRIKES} messages")


def said_since(between: Middleman, connections: int) -> int:
    """Bytes that who connects has said over the connections made after the first so many."""
    return sum(len(up) for _, up in between.recorded[connections:])


def replay(between: Middleman, onto: str) -> None:
    """Say to a node all that an allowed display has said to it; it must say nothing of the
    stream, which the record of that connection is full of."""
    down, up = max(between.recorded, key=lambda record: len(record[0]))
    with socket.create_connection(("127.0.0.1", port(onto)), timeout=2) as again:
        again.sendall(bytes(up))
        heard = b""
        while chunk := receive(again):
            heard += chunk
    # A greeting and a WELCOME; a READY is for who has the secret key.
    assert len(heard) < 400 < len(down)


def receive(connection: socket.socket) -> bytes:
    try:
        return connection.recv(1 << 16)
    except OSError:
        return b""


def test_what_is_replayed_or_reflected_to_who_connects_is_not_believed(
    context: Context, tmp_path: Path
) -> None:
    keyring = Keyring(tmp_path / "keys")
    keyring.allow("finger")
    bound, address = free_address(), free_address()
    gate = Authenticator(context, keyring.server())
    data = sockets.bind(context, zmq.PUB, bound, gate)
    with middleman(port(address), port(bound)) as between:
        listener = subscribed(context, address, keyring)

        def heard() -> bool:
            gate.poll(time.monotonic_ns())
            sockets.send(data, b"secret")
            return bool(listener.poll(0))

        until(heard)
        until(lambda: heard() and len(between.recorded[0][0]) > 2 * HANDSHAKE_BYTES)
        ((down, _),) = between.recorded
    for say in (lambda _: bytes(down), lambda asked: asked):
        with Parrot(say) as parrot:
            victim = subscribed(context, parrot.address, keyring)
            until(lambda parrot=parrot: parrot.answers >= 1)
            assert not victim.poll(300)
            victim.close(0)


def test_a_message_altered_on_its_way_to_who_binds_is_refused_though_zeromq_ends_nothing(
    context: Context, tmp_path: Path
) -> None:
    keyring = Keyring(tmp_path / "keys")
    keyring.allow("finger")
    bound, address = free_address(), free_address()
    gate = Authenticator(context, keyring.server())
    desk = sockets.bind(context, zmq.ROUTER, bound, gate)
    heard: list[bytes] = []

    def tend() -> None:
        gate.poll(time.monotonic_ns())
        sockets.send(guest, bytes(MESSAGE_BYTES))
        heard.extend(message for _, message in sockets.receive_all(desk))

    with middleman(port(address), port(bound)) as between:
        guest = sockets.connect(context, zmq.DEALER, address, keyring.client("finger"))
        until(lambda: tend() or heard)
        between.up = Once(flip_a_bit)
        until(lambda: tend() or gate.rejected["not_authentic"] == 1)
    assert set(heard) == {bytes(MESSAGE_BYTES)}


def test_messages_that_are_joined_on_the_way_are_refused(context: Context, tmp_path: Path) -> None:
    keyring = Keyring(tmp_path / "keys")
    keyring.allow("finger")
    address, behind, sensed = free_address(), free_address(), tmp_path / "sensed.json"
    arguments = (str(RADIAL), "--bind", behind, "--key", keyring.path("wrist"))
    control = sockets.control_address(address)
    with (
        middleman(port(control), port(behind) + 1) as between,
        process("sensing_node.cli", *arguments, "--json", str(sensed)) as wrist,
    ):
        guest = sockets.connect(context, zmq.DEALER, control, keyring.client("finger"))

        def asked() -> bool:
            sockets.send(guest, encode_control(Hello("d" * MESSAGE_BYTES)))
            return bool(guest.poll(20) and guest.recv())

        until(asked)
        between.up = join = Once(with_a_further_part)
        until(lambda: asked() and join.done)
        between.up = None
        until(asked)
        wrist.terminate()
        assert wrist.wait(PATIENCE_S) == 0
    assert read_json(sensed)["rejected"] == {"malformed": 1}


def with_a_further_part(data: bytes) -> bytes:
    """A frame of ZMTP says in its first byte that more of its message follows."""
    return bytes([data[0] | 1]) + data[1:]


def test_what_a_node_says_reflected_to_it_gets_no_frame(context: Context, tmp_path: Path) -> None:
    keyring = Keyring(tmp_path / "keys")
    gate = Authenticator(context, keyring.server())
    address = free_address()
    data = sockets.bind(context, zmq.PUB, address, gate)
    heard, end_s = b"", time.monotonic() + QUIET_S
    with socket.create_connection(("127.0.0.1", port(address)), timeout=0.02) as mirror:
        while time.monotonic() < end_s:
            gate.poll(time.monotonic_ns())
            sockets.send(data, b"secret" * 100)
            with contextlib.suppress(TimeoutError):
                back = mirror.recv(1 << 16)
                mirror.sendall(back)
                heard += back
    # A greeting that says nothing of the stream.
    assert 0 < len(heard) < 100
    until(lambda: gate.poll(time.monotonic_ns()) or gate.rejected["handshake"] == 1)


def subscribed(context: Context, address: str, keyring: Keyring) -> sockets.Socket:
    listener = sockets.connect(context, zmq.SUB, address, keyring.client("finger"))
    listener.subscribe(b"")
    return listener


class Parrot(socketserver.ThreadingTCPServer):
    """Answers what it is asked with what `say` makes of it."""

    daemon_threads = False

    def __init__(self, say: Callable[[bytes], bytes]) -> None:
        super().__init__(("127.0.0.1", 0), _Answer)
        self.say = say
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
        assert isinstance(self.server, Parrot)
        with contextlib.suppress(OSError):
            self.request.settimeout(0.5)
            while asked := self.request.recv(1 << 16):
                self.request.sendall(self.server.say(asked))
                self.server.answers += 1
