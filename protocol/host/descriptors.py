"""Waiting until descriptors can be read or written, whatever their numbers are.

`select.select` takes no descriptor above 1 023 on POSIX systems, and a node with many displays has
more than that (`raise_file_limit`). `select.poll` takes any, but counts whole milliseconds, which
is too coarse for a loop of 1 kHz. Linux's ppoll has neither limit. Windows has `select` alone,
which takes sockets of any number there.
"""

import ctypes
import select
import sys
import time
from collections.abc import Sequence
from functools import cached_property
from typing import Any

# FD_SETSIZE of Linux and macOS.
SELECT_TAKES = 1_024
# Of <poll.h>, the same on every Linux.
_POLLIN, _POLLOUT = 0x1, 0x4


class _PollFd(ctypes.Structure):
    _fields_ = (
        ("fd", ctypes.c_int),
        ("events", ctypes.c_short),
        ("revents", ctypes.c_short),
    )


class _TimeSpec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


def _find_ppoll() -> Any:
    """Return ppoll, which Python does not offer; None on other systems than Linux."""
    if sys.platform != "linux":
        return None
    function = ctypes.CDLL(None).ppoll
    # Pointers as numbers, since their conversion would cost as much as the call.
    function.argtypes = (ctypes.c_void_p, ctypes.c_ulong, ctypes.c_void_p, ctypes.c_void_p)
    return function


_PPOLL = _find_ppoll()


class DescriptorSet:
    """The descriptors that a loop waits for, to be read; registered once, for many waits."""

    def __init__(self, numbers: Sequence[int]) -> None:
        self.numbers = tuple(numbers)
        self._count = len(self.numbers)
        self._entries = (_PollFd * self._count)(*[_PollFd(n, _POLLIN) for n in self.numbers])
        self._limit = _TimeSpec()
        self._entries_at = ctypes.addressof(self._entries)
        self._limit_at = ctypes.addressof(self._limit)

    @cached_property
    def _poll(self) -> Any:
        return _registered(self.numbers, writable=False)

    def wait(self, timeout_ns: int) -> bool:
        """Wait until one can be read, or for `timeout_ns`; return whether one can be.

        A signal may end the wait. An end or an error of a descriptor counts as readable.
        """
        if _PPOLL is not None:
            limit = self._limit
            limit.seconds, limit.nanoseconds = divmod(max(timeout_ns, 0), 1_000_000_000)
            ready: int = _PPOLL(self._entries_at, self._count, self._limit_at, None)
            return ready > 0
        return bool(_ready(self._poll, self.numbers, max(timeout_ns, 0) * 1e-9, writable=False))

    def ready(self) -> list[int]:
        """Return the numbers of those that can be read now."""
        return _ready(self._poll, self.numbers, 0.0, writable=False)


def await_readable(number: int, within_s: float) -> bool:
    """Wait until a descriptor can be read, at most `within_s`; return whether it can be."""
    return bool(_ready(_registered((number,), False), (number,), within_s, writable=False))


def await_writable(number: int, within_s: float | None) -> bool:
    """Wait as `await_readable` does, until a descriptor can be written; None: without limit.

    A connection that was refused counts as writable.
    """
    return bool(_ready(_registered((number,), True), (number,), within_s, writable=True))


def _registered(numbers: Sequence[int], writable: bool) -> Any:
    """Return a `select.poll` object for descriptors; None where `select` is used for them."""
    # Windows has no poll, and macOS's does not support devices (its manual page, "BUGS").
    few = sys.platform == "darwin" and max(numbers, default=0) < SELECT_TAKES
    if few or not hasattr(select, "poll"):
        return None
    poll = select.poll()
    for number in numbers:
        poll.register(number, _POLLOUT if writable else _POLLIN)
    return poll


def _ready(poll: Any, numbers: Sequence[int], within_s: float | None, writable: bool) -> list[int]:
    """Return the descriptors that are ready within a time; none at its end."""
    if poll is not None:
        # A poll rounds up to whole milliseconds.
        return [number for number, _ in poll.poll(None if within_s is None else within_s * 1e3)]
    if not numbers and within_s is not None:
        # Windows refuses to wait for nothing.
        time.sleep(within_s)
        return []
    if writable:
        # Windows reports a connection that is refused as exceptional.
        _, ready, failed = select.select((), numbers, numbers, within_s)
        return [*ready, *failed]
    return select.select(numbers, (), (), within_s)[0]
