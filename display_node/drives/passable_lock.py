"""The lock between the loop's thread and a drive's own, which a stalled loop cannot keep."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

# The loop holds the lock for microseconds, or while a full bus takes its command: 50 ms at most.
PATIENCE_S = 0.05


class PassableLock:
    """Lock of what a drive is commanded, held by `with` in the loop's thread.

    A loop that stands still while it holds the lock must not keep the drive's thread from
    withdrawing the tip. That thread holds the lock by `with lock.passing()`, which goes on without
    it where it is not released in time. What both may then do at once must bear that: values that
    are replaced in one step, and times that may be older than the last.

    lock: one that others hold as well; its own without.
    """

    def __init__(self, lock: "threading.Lock | None" = None) -> None:
        self._lock = threading.Lock() if lock is None else lock
        self._passing = False

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    @contextmanager
    def passing(self) -> Iterator[None]:
        """Hold the lock, or go on without it after `PATIENCE_S`.

        Until it can be had again, the next calls do not wait: a withdrawal needs a command every
        few milliseconds.
        """
        held = self._lock.acquire(timeout=0.0 if self._passing else PATIENCE_S)
        self._passing = not held
        try:
            yield
        finally:
            if held:
                self._lock.release()
