"""Waiting for events in another thread or process."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

PATIENCE_S = 20.0


def until(done: Callable[[], object], patience_s: float = PATIENCE_S) -> None:
    """Wait until a function returns something true."""
    give_up_s = time.monotonic() + patience_s
    while not done():
        assert time.monotonic() < give_up_s, "it never came"
        time.sleep(0.005)


@contextmanager
def polled(poll: Callable[[], object]) -> Iterator[None]:
    """Call `poll` in a thread until the end of the block."""
    over = threading.Event()

    def run() -> None:
        while not over.is_set():
            poll()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
