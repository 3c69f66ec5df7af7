"""Bytes that are altered, replayed or reflected on the way between two nodes with keys."""

import contextlib
import socket
import time
from pathlib import Path

import zmq

from protocol.sockets import Context
from tests.support.hostile_peers import port_of
from tests.support.keyring import Keyring
from tests.support.live_display import await_state, await_status, subscribe
from tests.support.middleman import (
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
