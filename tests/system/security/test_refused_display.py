"""Reason that a display gives while sensing nodes refuse its key, over one address or several."""

import socket as plain
import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from pathlib import Path

import pytest
import zmq

from display_node.reception.connection import Connection
from display_node.reception.reachability import NOBODY
from display_node.telemetry.alerts import alerts
from display_node.telemetry.terminal_view import compose
from display_node.verdict import verdict
from protocol import sockets
from protocol.security.allow_list import AllowList
from protocol.security.authenticator import Authenticator
from protocol.security.link_keys import ServerKeys
from protocol.sockets import Context, control_address
from protocol.summary.fields import Summary
from protocol.wire.messages import Welcome, encode_control
from tests.support.keyring import Keyring
from tests.support.live_display import await_status, subscribe
from tests.support.nodes import RADIAL, free_address, process
from tests.support.streams import description
from tests.support.waiting import PATIENCE_S, polled

REMEDY = "; there: telepulse keys allow thumb.pub"


class Ports:
    """Bound ports of a sensing node, each with the keys that it requires, and one process' ZAP."""

    def __init__(self, keys: ServerKeys | None, *bound: tuple[int, str]) -> None:
        self._context = zmq.Context()
        self._authenticator = Authenticator(self._context, keys)
        self.sockets = [
            sockets.bind(self._context, kind, address, self._authenticator)
            for kind, address in bound
        ]

    @property
    def rejected(self) -> Mapping[str, int]:
        return self._authenticator.rejected

    def poll(self) -> None:
        self._authenticator.poll(time.perf_counter_ns())

    def close(self) -> None:
        self._context.destroy(linger=0)


def both(address: str) -> tuple[tuple[int, str], tuple[int, str]]:
    """Return the data port and the control port of an address."""
    return (zmq.XPUB, address), (zmq.ROUTER, control_address(address))


def poll_until(connection: Connection, done: Callable[[], bool], *served: Ports) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not done():
        now_ns = time.perf_counter_ns()
        assert time.monotonic() < end_s, connection.waiting_for(now_ns)
        for ports in served:
            ports.poll()
        connection.poll(now_ns)
        list(connection.control_messages())
        time.sleep(0.001)


def reason(connection: Connection) -> str:
    return "; ".join(map(str, connection.waiting_for(time.perf_counter_ns())))


def by_name(address: str) -> str:
    """Return an address as a person gives it, with a name that is looked up."""
    return address.replace("127.0.0.1", "localhost")


def test_a_refusal_ends_when_the_sensing_node_is_switched_off(
    context: Context, keyring: Keyring, address: str, logged: list[str]
) -> None:
    given = by_name(address)
    connection = Connection(context, [given], 1, keyring.client("thumb"))
    refusal = f"{given} does not allow the key of thumb{REMEDY}"
    with closing(Ports(keyring.server(), *both(address))) as node:
        poll_until(connection, lambda: reason(connection) == refusal, node)
        assert connection.refused == "refused_key"
        # ZeroMQ does not connect again: a display does, and is refused again.
        poll_until(connection, lambda: connection.rejected["refused_key"] > 4, node)
        assert reason(connection) == refusal
        # No connection without a handshake: the reason is known.
        assert node.rejected.keys() == {"unknown_key"}
    assert [line for line in logged if "thumb" in line] == [refusal]
    poll_until(connection, lambda: reason(connection).startswith("nobody listens at"))
    assert reason(connection).startswith(f"nobody listens at {given}")
    assert connection.refused is None
    connection.close()


def test_each_address_has_a_reason_of_its_own(
    context: Context, keyring: Keyring, tmp_path: Path
) -> None:
    """As when one path leads to a node that allows nobody, and another to the one that is meant."""
    refusing, accepting = free_address(), free_address()
    nobody = ServerKeys(keyring.pair("wrist"), AllowList(tmp_path / "none"))
    given = [by_name(refusing), by_name(accepting)]
    connection = Connection(context, given, 2, keyring.client("finger"))
    refusal = f"{given[0]} does not allow the key of finger; there: telepulse keys allow finger.pub"
    with closing(Ports(nobody, *both(refusing))) as first:
        absent = f"nobody listens at {given[1]}"
        poll_until(connection, lambda: absent in reason(connection), first)
        assert reason(connection).startswith(f"{refusal}; {absent}")
        with closing(Ports(keyring.server(), *both(accepting))) as second:
            sends_nothing = f"{refusal}; {given[1]} is connected, but sends nothing"
            poll_until(connection, lambda: reason(connection) == sends_nothing, first, second)
            assert connection.refused == "refused_key"
    connection.close()


def test_of_two_addresses_the_one_that_refuses_is_shown_first_and_alone_in_a_line(
    context: Context, keyring: Keyring
) -> None:
    absent, refusing = free_address(), free_address()
    connection = Connection(context, [absent, refusing], 2, keyring.client("thumb"))
    refusal, nobody = f"{refusing} does not allow the key of thumb", f"nobody listens at {absent}"
    with closing(Ports(keyring.server(), *both(refusing))) as node:
        poll_until(
            connection, lambda: all(each in reason(connection) for each in (refusal, nobody)), node
        )
    waiting_for = connection.waiting_for(time.perf_counter_ns())
    summary = Summary(refused=connection.refused, waiting_for=waiting_for)
    found = alerts("waiting", summary.to_dict())
    assert [alert.name for alert in found] == ["not connected"]
    assert found[0].text.startswith(f"{refusal}{REMEDY}; {nobody}")
    assert compose("waiting", [], found) == f"waiting: not connected: {refusal}"
    # Each address is followed by its own remedy.
    (first, second) = map(str, waiting_for)
    assert first == f"{refusal}{REMEDY}"
    assert second.endswith(f"; {NOBODY.further}")
    assert f"; {first}; {second}." in verdict(summary).lines[0]
    connection.close()


def test_a_control_port_that_is_no_node_is_the_reason_although_data_is_connected(
    context: Context, keyring: Keyring, address: str
) -> None:
    """As when a router forwards the control port to another machine."""
    given = by_name(address)
    connection = Connection(context, [given], 1, keyring.client("finger"))
    host, _, port = control_address(address).removeprefix("tcp://").rpartition(":")
    data, _ = both(address)
    with (
        plain.create_server((host, int(port))) as other,
        closing(Ports(keyring.server(), data)) as node,
    ):

        def break_off() -> None:
            with suppress(TimeoutError):
                other.accept()[0].close()

        other.settimeout(0.1)
        with polled(break_off):
            refusal = f"{given} breaks off; it is not wrist, whose public key --peer gives"
            poll_until(connection, lambda: reason(connection) == refusal, node)
            assert connection.refused == "handshake"
    connection.close()


@pytest.mark.skipif(not zmq.has("ipc"), reason="no ipc here")
def test_of_two_ipc_addresses_one_that_accepted_revokes_nothing_at_the_other(
    context: Context, keyring: Keyring, tmp_path: Path
) -> None:
    accepting, refusing = f"ipc://{tmp_path}/a", f"ipc://{tmp_path}/b"
    nobody = ServerKeys(keyring.pair("wrist"), AllowList(tmp_path / "none"))
    connection = Connection(context, [accepting, refusing], 2, keyring.client("finger"))
    with closing(Ports(keyring.server(), *both(accepting))) as first:
        poll_until(connection, lambda: len(connection.established) > 0, first)
        with closing(Ports(nobody, *both(refusing))) as second:
            poll_until(connection, lambda: connection.refused is not None, first, second)
            assert connection.refused == "refused_key"
    assert "revoked" not in connection.rejected
    connection.close()


def test_a_display_that_was_welcomed_names_the_refusal_and_not_the_first_samples(
    context: Context, keyring: Keyring, tmp_path: Path, address: str
) -> None:
    """As when its key is revoked between the sensing node's answer and the first frame."""
    nobody = ServerKeys(keyring.pair("wrist"), AllowList(tmp_path / "none"))
    telemetry = free_address()
    reader = subscribe(context, telemetry)
    keys = ("--key", keyring.path("finger"), "--peer", keyring.path("wrist", "pub"))
    options = ("--connect", address, "--no-screen", "--telemetry", telemetry, *keys)
    data, control = both(address)
    with (
        closing(Ports(nobody, data)) as refusing,
        closing(Ports(keyring.server(), control)) as welcoming,
    ):
        (router,) = welcoming.sockets
        welcome = encode_control(Welcome(1, 0, description()))

        def answer() -> None:
            refusing.poll()
            welcoming.poll()
            for sender, _ in sockets.receive_multipart(router):
                sockets.send(router, sender, welcome)
            time.sleep(0.001)

        with polled(answer), process("display_node.cli", str(RADIAL), *options):
            status = await_status(reader, lambda status: bool(status.summary["refused"]))
            status = await_status(reader, lambda status: status.stream == "test pulse")
    assert status.state == "waiting"
    (why,) = status.summary["waiting_for"]
    assert why["text"] == f"{address} does not allow the key of finger"
