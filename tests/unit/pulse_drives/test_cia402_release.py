"""A CiA 402 node that cannot be opened, or closed: its bus and its thread are released."""

import threading
from collections import Counter
from collections.abc import Callable
from typing import Any

import can
import canopen
import pytest

from pulse_drives.cia402.node import Cia402Node
from telepulse.testing.conformance import check_release
from tests.support.drive_benches import cia402_scene
from tests.unit.pulse_drives.test_axis import AXIS

FAILURES = (RuntimeError("can't start new thread"), MemoryError("no memory"), OSError("pulled"))


@pytest.fixture
def buses(monkeypatch: pytest.MonkeyPatch) -> list[can.BusABC]:
    """The buses that are opened, of python-can's own virtual kind."""
    opened: list[can.BusABC] = []
    bus = can.Bus

    def open_one(**settings: Any) -> can.BusABC:
        opened.append(bus(**settings))
        return opened[-1]

    monkeypatch.setattr(can, "Bus", open_one)
    return opened


def failing(error: Exception) -> Callable[..., None]:
    def fail(*_: object, **__: object) -> None:
        raise error

    return fail


def failing_after(call: Callable[..., object], error: Exception) -> Callable[..., None]:
    def fail(*arguments: object, **options: object) -> None:
        call(*arguments, **options)
        raise error

    return fail


def node(counts: Counter[str]) -> Cia402Node:
    return Cia402Node(cia402_scene(interface="virtual", channel="release"), AXIS, counts)


@pytest.mark.parametrize("error", FAILURES)
@pytest.mark.parametrize("place", ["add_node", "subscribe", "connect", "connected", "thread"])
def test_a_node_that_cannot_be_built_keeps_neither_bus_nor_thread(
    place: str, error: Exception, buses: list[can.BusABC], monkeypatch: pytest.MonkeyPatch
) -> None:
    if place == "thread":
        monkeypatch.setattr(threading.Thread, "start", failing(error))
    elif place == "connected":
        connect = canopen.Network.connect
        monkeypatch.setattr(canopen.Network, "connect", failing_after(connect, error))
    else:
        monkeypatch.setattr(canopen.Network, place, failing(error))
    with check_release("a node that was not built"), pytest.raises(type(error)):
        node(Counter())
    (bus,) = buses
    assert bus._is_shutdown


@pytest.mark.parametrize("error", FAILURES)
@pytest.mark.parametrize("place", ["command", "pdo", "listener"])
def test_a_node_that_fails_while_it_is_closed_keeps_neither_bus_nor_thread(
    place: str, error: Exception, buses: list[can.BusABC], monkeypatch: pytest.MonkeyPatch
) -> None:
    counts: Counter[str] = Counter()
    with check_release("close"):
        opened = node(counts)
        monkeypatch.setattr("pulse_drives.cia402.node.SDO_TIMEOUT_S", 1e-3)
        opened._node.sdo.RESPONSE_TIMEOUT = 1e-3
        if place == "command":
            monkeypatch.setattr(opened, "command", failing(error))
        elif place == "pdo":
            monkeypatch.setattr(opened._node.pdo, "stop", failing(error))
        else:
            opened._network.listeners[0].stop = failing(error)
        opened.close()
    (bus,) = buses
    assert bus._is_shutdown
    assert counts.total()
    assert not [each for each in threading.enumerate() if "Notifier" in each.name]
