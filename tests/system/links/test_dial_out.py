"""A sensing node that dials out to a relay, which joins displays to it."""

import signal
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path

import pytest
import zmq

from protocol import sockets, tunnel
from protocol.security.keys import ClientKeys, ServerKeys
from protocol.sockets import Context, Socket
from telepulse.tunnel_relay import MAX_UNPROVEN, SPARES, TunnelRelay
from tests.support.hostile_peers import GREETING, port_of
from tests.support.ipv6 import needs_ipv6
from tests.support.keyring import Keyring
from tests.support.live_display import await_state, subscribe
from tests.support.log_lines import refused
from tests.support.middleman import middleman
from tests.support.nodes import RADIAL, assert_accounted, free_address, process, read_json
from tests.support.waiting import PATIENCE_S, until
from tests.support.ways import ThreeKeyrings

NAME = b"radial pulse"


@pytest.fixture
def keys(tmp_path: Path) -> ThreeKeyrings:
    return ThreeKeyrings(tmp_path)


@pytest.mark.smoke
def test_the_relay_carries_ciphertext_and_displays_return_after_its_restart(
    context: Context, keys: ThreeKeyrings, tmp_path: Path
) -> None:
    nodes, bind, near, telemetry, own = (free_address() for _ in range(5))
    sensed, played = tmp_path / "sensed.json", tmp_path / "played.json"
    relay = ("tunnel", "--nodes", nodes, "--bind", bind, *keys.for_relay())
    wrist = (str(RADIAL), "--bind", own, "--dial-out", nodes, *keys.for_wrist())
    wrist += ("--peer", keys.relays_public)
    finger = (str(RADIAL), "--connect", near, "--telemetry", telemetry, *keys.for_finger())
    screen = subscribe(context, telemetry)
    with (
        middleman(port_of(near), port_of(bind)) as data,
        middleman(port_of(near) + 1, port_of(bind) + 1) as control,
        process("sensing_node.cli", *wrist, "--json", str(sensed)) as sensing,
        process("display_node.cli", *finger, "--no-screen", "--once", "--json", str(played)) as on,
    ):
        with process("telepulse", *relay):
            await_state(screen, "playing")
        await_state(screen, "stale")
        with process("telepulse", *relay) as restarted:
            await_state(screen, "playing")
            sensing.send_signal(signal.SIGTERM)
            assert sensing.wait(PATIENCE_S) == 0
            assert on.wait(PATIENCE_S) == 0
            restarted.send_signal(signal.SIGINT)
            _, errors = restarted.communicate(timeout=PATIENCE_S)
    assert restarted.returncode == 0
    assert "sensing node wrist has registered" in errors
    assert "sensing node wrist has ended" in errors
    assert "tunnels carried" in errors
    summary = read_json(played)
    samples = summary["samples"]
    assert_accounted(samples)
    assert samples["sent"] + samples["before_joining"] == read_json(sensed)["samples"]["sent"]
    assert samples["played"] > 0
    passed = b"".join(
        bytes(one) for way in (data, control) for pair in way.recorded for one in pair
    )
    assert len(passed) > 10_000
    assert NAME not in passed


@needs_ipv6
def test_a_node_dials_out_and_displays_connect_by_ipv6(tmp_path: Path) -> None:
    nodes, near, own = (free_address().replace("127.0.0.1", "[::1]") for _ in range(3))
    played = tmp_path / "played.json"
    sense = (str(RADIAL), "--bind", own, "--dial-out", nodes, "--seconds", "2")
    play = (str(RADIAL), "--connect", near, "--no-screen", "--once", "--json", str(played))
    with (
        process("telepulse", "tunnel", "--nodes", nodes, "--bind", near),
        process("display_node.cli", *play) as display,
        process("sensing_node.cli", *sense) as sensing,
    ):
        assert sensing.wait(PATIENCE_S) == 0
        assert display.wait(PATIENCE_S) == 0
    samples = read_json(played)["samples"]
    assert_accounted(samples)
    assert samples["played"] > 0


@contextmanager
def relaying(keys: ServerKeys | None) -> Iterator[tuple[TunnelRelay, str, str]]:
    """Run a relay in a thread; provide it and its addresses for displays and sensing nodes."""
    bind, nodes = free_address(), free_address()
    relay = TunnelRelay(bind, nodes, keys)
    thread = threading.Thread(target=relay.run)
    thread.start()
    try:
        yield relay, bind, nodes
    finally:
        relay.stop()
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


def call(port: int) -> socket.socket:
    connection = socket.create_connection(("127.0.0.1", port), PATIENCE_S)
    connection.settimeout(PATIENCE_S)
    return connection


def ended(connection: socket.socket) -> bool:
    """Return whether the relay closes a connection without having sent anything."""
    with suppress(ConnectionResetError):
        return connection.recv(1) == b""
    return True


def opened(node: Socket, count: int) -> list[tuple[int, bytes]]:
    """Return the next requests of the relay to a registered node."""
    found: list[tuple[int, bytes]] = []
    while len(found) < count:
        message = node.recv()
        if message != tunnel.REGISTERED:
            found.append(tunnel.decode_open(message))
    return found


def register(context: Context, nodes: str, keys: ClientKeys | None = None) -> Socket:
    node = sockets.connect(context, zmq.DEALER, nodes, keys)
    node.setsockopt(zmq.RCVTIMEO, int(PATIENCE_S * 1000))
    node.send(tunnel.REGISTER)
    return node


def test_hostile_peers_at_the_relay_are_cut_and_a_display_still_passes(
    context: Context, logged: list[str]
) -> None:
    with relaying(None) as (relay, bind, nodes), ExitStack() as stack:
        node = register(context, nodes)
        tokens = dict(reversed(opened(node, 2 * SPARES)))
        # Garbage, a token that nobody gave, an end in the middle of a token.
        for port, data in (
            (port_of(bind), b"GET / HTTP/1.1\r\n\r\n"),
            (port_of(bind) + 1, b"\xff" * 10),
            (port_of(nodes) + 1, bytes(tunnel.TOKEN_BYTES)),
        ):
            with closing(call(port)) as peer:
                peer.sendall(data)
                assert ended(peer)
        with closing(call(port_of(nodes) + 1)) as peer:
            peer.sendall(b"abc")
        # Peers that send nothing give way to later ones from their address.
        silent = [stack.enter_context(call(port_of(bind))) for _ in range(MAX_UNPROVEN + 5)]
        assert all(map(ended, silent[:5]))
        # A display is joined to the connection that the node opens; both ways are open.
        display = stack.enter_context(call(port_of(bind)))
        display.sendall(GREETING)
        with closing(call(port_of(nodes) + 1)) as dialled:
            dialled.sendall(tokens[tunnel.DATA])
            dialled.settimeout(PATIENCE_S)
            assert dialled.recv(1024) == GREETING
            # A token opens one connection.
            with closing(call(port_of(nodes) + 1)) as again:
                again.sendall(tokens[tunnel.DATA])
                assert ended(again)
            large = bytes(16_000_000)
            sending = threading.Thread(target=dialled.sendall, args=(large,))
            sending.start()
            time.sleep(0.3)
            assert sending.is_alive()  # the relay holds back what a display does not read
            received = 0
            while received < len(large):
                received += len(display.recv(1 << 20))
            sending.join(PATIENCE_S)
        assert ended(display)
        # A flood of connections from one address is refused.
        for _ in range(200):
            call(port_of(bind)).close()
        until(lambda: relay.rejected["flood"])
    assert relay.rejected["handshake"] >= 10
    assert sum("refused 127.0.0.1" in line for line in logged) <= 3


def test_only_an_allowed_key_registers_and_no_other_takes_its_place(
    context: Context, tmp_path: Path, logged: list[str]
) -> None:
    keyring = Keyring(tmp_path)
    for name in ("one", "two"):
        keyring.allow(name)
    with relaying(keyring.server()) as (_, _, nodes):
        stranger = register(context, nodes, keyring.client("stranger"))
        first = register(context, nodes, keyring.client("one"))
        assert first.recv() == tunnel.REGISTERED
        second = register(context, nodes, keyring.client("two"))
        assert second.recv() == tunnel.TAKEN
        # The same key from a new connection, as after a restart, takes its own place again.
        again = register(context, nodes, keyring.client("one"))
        assert again.recv() == tunnel.REGISTERED
        again.send(tunnel.END)
        second.send(tunnel.REGISTER)
        while second.recv() != tunnel.REGISTERED:
            second.send(tunnel.REGISTER)
        stranger.setsockopt(zmq.RCVTIMEO, 200)
        with pytest.raises(zmq.Again):
            stranger.recv()
    assert "sensing node two has registered" in logged


def test_dial_out_and_a_relay_need_keys_beyond_this_machine() -> None:
    line = refused("sensing_node.cli", str(RADIAL), "--dial-out", "tcp://192.0.2.1:5755")
    assert "reaches beyond this machine without keys" in line
    line = refused("sensing_node.cli", str(RADIAL), "--peer", "relay.pub")
    assert "needs --dial-out" in line
    line = refused("telepulse", "tunnel", "--nodes", "tcp://*:5755")
    assert "reaches beyond this machine without keys" in line
