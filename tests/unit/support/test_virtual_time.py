"""Threads, clock and stalls in the virtual time of benches."""

import sys
import threading
import time
from collections.abc import Iterator
from types import ModuleType
from typing import Any

import pytest

from tests.support.virtual_time import VirtualTime

MS = 1_000_000


@pytest.fixture
def world() -> VirtualTime:
    return VirtualTime(now_ns=0)


@pytest.fixture
def here(world: VirtualTime, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Provide a module that reads the clock and starts threads, in virtual time."""
    module: Any = ModuleType("here")
    module.time, module.threading = time, threading
    monkeypatch.setitem(sys.modules, "here", module)
    with world.substituted(("here",)):
        yield module
    assert module.time is time


@pytest.mark.parametrize("step", [1, -1])
def test_stalled_threads_wake_together_in_the_order_that_is_chosen(
    world: VirtualTime, step: int
) -> None:
    seen: list[tuple[int, str]] = []

    def ticker(name: str) -> None:
        while True:
            world.sleep(10e-3)
            seen.append((world.now_ns // MS, name))

    order = [world.thread(ticker, name, name=name) for name in ("loop", "drive")][::step]
    world.run(15 * MS)
    world.stall(order, 55 * MS)
    world.run(60 * MS)
    assert [name for ms, name in seen if ms == 55] == [thread.name for thread in order]
    assert {ms for ms, _ in seen} == {10, 55}


def test_a_lock_is_waited_for_while_its_holder_is_stalled(world: VirtualTime, here: Any) -> None:
    lock = here.threading.Lock()
    seen: list[tuple[str, int]] = []

    def holder() -> None:
        with lock:
            world.perf_counter_ns()
            seen.append(("held", world.now_ns // MS))

    def other() -> None:
        world.sleep(5e-3)
        with lock:
            seen.append(("taken", world.now_ns // MS))

    thread = world.thread(holder)
    world.thread(other)
    world.interrupt(1, lambda: world.stall([thread], 40 * MS))
    world.run(100 * MS)
    assert seen == [("held", 40), ("taken", 40)]


def test_an_error_of_a_thread_ends_the_world(world: VirtualTime) -> None:
    def fail() -> None:
        world.sleep(1e-3)
        raise ZeroDivisionError

    world.thread(fail)
    with pytest.raises(ZeroDivisionError):
        world.run(10 * MS)
