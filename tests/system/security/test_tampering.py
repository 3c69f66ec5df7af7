"""Bytes that are altered, replayed or reflected on the way between two nodes with keys."""

import contextlib
import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import zmq

from protocol.sockets import Context
from tests.support.hostile_peers import port_of
from tests.support.keyring import Keyring
from tests.support.live_display import await_state, await_status, subscribe
from tests.support.nodes import RADIAL, assert_accounted, free_address, process, read_json
from tests.support.waiting import PATIENCE_S, until

Alter = Callable[[bytes], bytes]
CHUNK_BYTES = 1 << 16
# Longer than any of a handshake's last parts that could be mistaken for a frame.
MESSAGE_BYTES = 60
HANDSHAKE_BYTES = 800
ALTERATIONS, COUNTED_WITHIN_S = 6, 5.0
# Causes that a display counts when altered bytes get as far as its messages.
ACCEPTED = {"truncated", "not_msgpack", "version", "malformed", "not_finite", "duplicate"}


class Middleman:
    """A forwarder between the clients of one port and another port.

    down, up: functions that alter the bytes to and from a client. recorded: the bytes of each
    connection, down and up.
    """

    def __init__(self, listen: int, onto: int) -> None:
        self.down: Alter | None = None
        self.up: Alter | None = None
        self.recorded: list[tuple[bytearray, bytearray]] = []
        self._onto = onto
        self._open: list[socket.socket] = []
        self._server = socket.create_server(("127.0.0.1", listen))
        self._threads = [threading.Thread(target=self._accept)]
        self._threads[0].start()

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        self.cut()
        for thread in self._threads:
            thread.join()

    def cut(self) -> None:
        """End all connections."""
        for one in self._open:
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._server.accept()
                try:
                    server = socket.create_connection(("127.0.0.1", self._onto))
                except OSError:
                    client.close()
                    continue
                self._open += (client, server)
                self._threads.append(threading.Thread(target=self._forward, args=(client, server)))
                self._threads[-1].start()

    def _forward(self, client: socket.socket, server: socket.socket) -> None:
        """Forward one connection until either end closes it."""
        record = (bytearray(), bytearray())
        self.recorded.append(record)
        with client, server, contextlib.suppress(OSError):
            while True:
                for source in select.select([server, client], [], [])[0]:
                    upward = source is client
                    if not (data := source.recv(CHUNK_BYTES)):
                        return
                    record[upward].extend(data)
                    alter = self.up if upward else self.down
                    sink = server if upward else client
                    sink.sendall(data if alter is None else alter(data))


class Once:
    """Alteration of the first chunk that is long enough to hold a message."""

    def __init__(self, alter: Alter) -> None:
        self._alter = alter
        self.done = False

    def __call__(self, data: bytes) -> bytes:
        if self.done or len(data) < MESSAGE_BYTES:
            return data
        self.done = True
        return self._alter(data)


def flip_a_bit(data: bytes) -> bytes:
    """Flip one bit in the sealed part of the last message."""
    return data[:-8] + bytes([data[-8] ^ 1]) + data[-7:]


def twice(data: bytes) -> bytes:
    return data + data


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
        closing(Middleman(port_of(address), port_of(behind))) as data,
        closing(Middleman(port_of(address) + 1, port_of(behind) + 1)) as control,
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
