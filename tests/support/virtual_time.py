"""Threads in virtual time: the product's own threads, one at a time, on a simulated clock.

`VirtualTime.substituted` replaces `time` and `threading` in the named modules, which then wait in
virtual time. Each thread is a greenlet; the order of execution is the same in every run. A stall
stops threads as SIGSTOP or a busy host does, between any two readings of the clock, and chooses
the order in which they wake.
"""

import heapq
import itertools
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

from greenlet import getcurrent, greenlet


class VirtualThread:
    """A thread in virtual time; see `threading.Thread`."""

    def __init__(
        self,
        world: "VirtualTime",
        target: Callable[..., object],
        args: Sequence[Any] = (),
        name: str = "",
        daemon: bool = False,
    ) -> None:
        self.name = name or getattr(target, "__qualname__", "thread")
        self._world = world
        self._greenlet = greenlet(lambda: self._run(target, args), world.hub)
        # Waits are numbered: a wake-up of an earlier one is ignored.
        self.waits = 0
        self.resumes_ns = 0
        self.rank = 0
        self.ended = VirtualEvent(world)

    def start(self) -> None:
        self._world.threads.append(self)
        self._world.wake(self, self.waits)

    def join(self, timeout: float | None = None) -> None:
        self.ended.wait(timeout)

    def is_alive(self) -> bool:
        return not self.ended.is_set()

    def go_on(self) -> None:
        self._greenlet.switch()

    def _run(self, target: Callable[..., object], args: Sequence[Any]) -> None:
        try:
            target(*args)
        finally:
            self._world.threads.remove(self)
            self.ended.set()


class VirtualEvent:
    """See `threading.Event`."""

    def __init__(self, world: "VirtualTime") -> None:
        self._world = world
        self._is_set = False
        self._waiting: list[tuple[VirtualThread, int]] = []

    def is_set(self) -> bool:
        return self._is_set

    def set(self) -> None:
        self._is_set = True
        for thread, wait in self._waiting:
            self._world.wake(thread, wait)
        self._waiting.clear()

    def clear(self) -> None:
        self._is_set = False

    def wait(self, timeout: float | None = None) -> bool:
        world = self._world
        # A wait for the last fraction of a nanosecond must end, too.
        wait_ns = 0 if not timeout or timeout < 0 else max(1, round(timeout * 1e9))
        until_ns = None if timeout is None else world.now_ns + wait_ns
        while not self._is_set and (until_ns is None or world.now_ns < until_ns):
            thread = world.current
            if thread is None:
                world.step(until_ns)
                continue
            thread.waits += 1
            self._waiting.append((thread, thread.waits))
            world.pause(until_ns)
        return self._is_set


class VirtualLock:
    """See `threading.Lock`."""

    def __init__(self, world: "VirtualTime") -> None:
        self._free = VirtualEvent(world)
        self._free.set()

    def __enter__(self) -> bool:
        return self.acquire()

    def __exit__(self, *_: object) -> None:
        self.release()

    def acquire(self, timeout: float | None = None) -> bool:
        # Another thread may take it before the one that its release has woken runs.
        while not self._free.is_set():
            if not self._free.wait(timeout) and timeout is not None:
                return False
        self._free.clear()
        return True

    def release(self) -> None:
        self._free.set()


class VirtualTime:
    """The clock, the threads and the events of one virtual world.

    now_ns: the time. threads: those that run. Code outside all of them, such as a test, may wait as
    well; the world continues meanwhile.
    """

    def __init__(self, now_ns: int = 1_000_000_000) -> None:
        self.now_ns = now_ns
        self.hub = getcurrent()
        self.threads: list[VirtualThread] = []
        self.current: VirtualThread | None = None
        self._order = itertools.count()
        # Time, rank, order, and either a thread with the number of its wait, or a function.
        self._due: list[tuple[int, int, int, VirtualThread | None, Any]] = []
        self._interruption: tuple[int, Callable[[], None]] | None = None

    def at(self, time_ns: int, happen: Callable[[], None]) -> None:
        """Call a function at a time, outside all threads."""
        heapq.heappush(self._due, (time_ns, -1, next(self._order), None, happen))

    def every(self, period_ns: int, happen: Callable[[], None]) -> None:

        def again() -> None:
            happen()
            self.at(self.now_ns + period_ns, again)

        self.at(self.now_ns + period_ns, again)

    def run(self, until_ns: int) -> None:
        while self._due and self._due[0][0] <= until_ns:
            self.step(until_ns)
        self.now_ns = until_ns

    def step(self, until_ns: int | None = None) -> None:
        """Execute the next event, if it is not after `until_ns`."""
        if not self._due:
            assert until_ns is not None, "all threads wait for each other"
        if not self._due or (until_ns is not None and self._due[0][0] > until_ns):
            assert until_ns is not None
            self.now_ns = until_ns
            return
        due_ns, _, _, thread, what = heapq.heappop(self._due)
        if thread is None:
            self.now_ns = max(self.now_ns, due_ns)
            what()
            return
        if what != thread.waits or thread.ended.is_set():
            return
        self.now_ns = max(self.now_ns, due_ns)
        if thread.resumes_ns > self.now_ns:
            self._push(thread.resumes_ns, thread, what)
            return
        thread.waits += 1
        self.current = thread
        thread.go_on()
        self.current = None

    def stall(self, threads: Sequence[VirtualThread], until_ns: int) -> None:
        """Stop threads until a time, when they wake in this order."""
        for rank, thread in enumerate(threads):
            thread.rank = rank
            thread.resumes_ns = max(thread.resumes_ns, until_ns)

    def interrupt(self, readings: int, begin: Callable[[], None]) -> None:
        """Call `begin`, which may stall threads, right after so many readings of the clock.

        A stall can so begin between a reading and its use.
        """
        self._interruption = (readings, begin)

    def wake(self, thread: VirtualThread, wait: int) -> None:
        self._push(self.now_ns, thread, wait)

    def _push(self, time_ns: int, thread: VirtualThread, wait: int) -> None:
        heapq.heappush(self._due, (time_ns, thread.rank, next(self._order), thread, wait))

    def pause(self, until_ns: int | None) -> None:
        """Suspend the current thread until it is woken, or until a time."""
        thread = self.current
        assert thread is not None
        if until_ns is not None:
            self._push(until_ns, thread, thread.waits)
        self.hub.switch()

    def perf_counter_ns(self) -> int:
        look_ns = self.now_ns
        if self.current is not None and self._interruption is not None:
            readings, begin = self._interruption
            self._interruption = (readings - 1, begin) if readings > 1 else None
            if readings <= 1:
                begin()
            if self.current.resumes_ns > self.now_ns:
                self.sleep((self.current.resumes_ns - self.now_ns) * 1e-9)
        return look_ns

    def monotonic(self) -> float:
        return self.perf_counter_ns() * 1e-9

    def sleep(self, seconds: float) -> None:
        VirtualEvent(self).wait(seconds)

    def thread(self, target: Callable[..., object], *args: object, name: str = "") -> VirtualThread:
        started = VirtualThread(self, target, args, name)
        started.start()
        return started

    @contextmanager
    def substituted(self, prefixes: Sequence[str]) -> Iterator[None]:
        """Replace `time` and `threading` in all loaded modules with one of these prefixes."""
        clock = SimpleNamespace(
            perf_counter_ns=self.perf_counter_ns, monotonic=self.monotonic, sleep=self.sleep
        )
        kinds = {"Thread": VirtualThread, "Event": VirtualEvent, "Lock": VirtualLock}
        threads = SimpleNamespace(**{name: partial(kind, self) for name, kind in kinds.items()})
        with ExitStack() as patches:
            for name, module in list(sys.modules.items()):
                if not name.startswith(tuple(prefixes)):
                    continue
                for attribute, real, ours in (
                    ("time", time, clock),
                    ("threading", threading, threads),
                ):
                    if getattr(module, attribute, None) is real:
                        patches.enter_context(patch.object(module, attribute, ours))
            yield
