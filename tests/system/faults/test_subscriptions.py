"""Peers that subscribe to anything, without end: what the nodes hold of it, what others notice."""

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
import zmq

from benchmarks.faults.hostile import port_of, subscribing
from benchmarks.faults.sequence_monitor import monitor_sequence
from benchmarks.faults.stage import staged, unaccounted
from protocol import sockets
from protocol.security.budgets import FOREIGN_BYTES, SUBSCRIPTION, SubscriptionBudget
from protocol.sockets import Context
from telepulse.processes import free_addresses
from tests.support.felt_force import assert_limits_kept
from tests.support.nodes import free_address, process
from tests.support.waiting import until

FLOOD_S = 0.6
# Without a bound it is hundreds of megabytes.
GROWN_BYTES = 40_000_000
TOPIC_BYTES = (10, 200, 900)


def test_endless_subscriptions_cost_a_node_little_and_its_display_nothing(tmp_path: Path) -> None:
    with staged(tmp_path) as stage:
        (stage.telemetry_address,) = free_addresses(1)
        sensing, display, finger = stage.play()
        held_bytes = [node.rss_bytes() for node in (sensing, display)]
        for address in (stage.connect[0], stage.telemetry_address):
            for topic_bytes in TOPIC_BYTES:
                subscribing(port_of(address), topic_bytes, FLOOD_S)
        for node, before_bytes in zip((sensing, display), held_bytes, strict=True):
            assert node.rss_bytes() - before_bytes < GROWN_BYTES
        stage.await_played(finger, 500)
        sent, account = sensing.end(), display.account()
    assert unaccounted(sent, account) == 0
    assert account.samples.lost == 0
    for summary in (sent, account):
        assert set(summary.rejected) == {SUBSCRIPTION}
    assert_limits_kept(finger)


def test_endless_subscriptions_cost_a_relay_little_and_go_no_further(tmp_path: Path) -> None:
    inner, outer = free_addresses(2)
    relay = ("relay", "--connect", inner, "--bind", outer)
    with staged(tmp_path) as stage, ExitStack() as stack:
        stage.bind, stage.connect = inner, [inner]
        sensing = stage.sense()
        node = stack.enter_context(process("telepulse", *relay))
        hearing = stack.enter_context(monitor_sequence(outer))
        until(lambda: hearing.sent)
        before_bytes = rss_bytes(node.pid)
        subscribing(port_of(outer), 200, FLOOD_S)
        assert rss_bytes(node.pid) - before_bytes < GROWN_BYTES
        sent = sensing.end()
        until(lambda: list(hearing.sent.values()) == [sent.samples.sent])
        node.terminate()
        _, errors = node.communicate(timeout=20)
    assert sent.rejected == {}
    assert errors.count("it subscribes to topics not published here") == 1


def rss_bytes(process_id: int) -> int:
    return int(Path(f"/proc/{process_id}/statm").read_text(encoding="ascii").split()[1]) * 4096


@contextmanager
def reader(context: Context, address: str) -> Iterator[sockets.Socket]:
    with context.socket(zmq.SUB) as one:
        one.setsockopt(zmq.LINGER, 0)
        one.connect(address)
        yield one


@pytest.mark.parametrize("ipc", [False, True])
def test_who_asks_for_a_little_else_stays_and_who_goes_on_is_cut_named_once_and_counted(
    context: Context, tmp_path: Path, ipc: bool, logged: list[str]
) -> None:
    address = f"ipc://{tmp_path}/data" if ipc else free_address()
    data = sockets.bind(context, zmq.XPUB, address)
    subscribers, said = SubscriptionBudget(data, (b"trace", b"status")), list[bytes]()
    with reader(context, address) as modest, reader(context, address) as greedy:

        def heard(one: sockets.Socket) -> int:
            said.extend(subscribers.receive())
            sockets.send(data, b"trace")
            return one.poll(5) and len(one.recv())

        for topic in (b"tra", b"something of a later version"):
            modest.subscribe(topic)
        until(lambda: heard(modest))
        greedy.subscribe(b"trace")
        until(lambda: heard(greedy))
        assert not logged
        number = 0

        def ask_on() -> bool:
            nonlocal number
            number += 1
            greedy.subscribe(b"%d" % number + bytes(100))
            heard(modest)
            return bool(logged)

        until(ask_on)
        assert number * 101 > FOREIGN_BYTES / 2
        end_s = time.monotonic() + 0.3
        while time.monotonic() < end_s:
            until(lambda: heard(modest))
    assert len(logged) == 1
    assert subscribers.rejected[SUBSCRIPTION] >= 1
    assert {b"\1tra", b"\1trace"} <= set(said) <= {b"\1tra", b"\1trace", b"\0trace"}
