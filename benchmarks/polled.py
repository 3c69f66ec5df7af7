"""What emulated hardware needs in a process of its driver: a thread that polls it."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def polled(poll: Callable[[], object]) -> Iterator[Callable[[], None]]:
    """Polls in a thread until the end of the `with`; yields what ends it sooner."""
    over = threading.Event()

    def run() -> None:
        while not over.is_set():
            poll()

    thread = threading.Thread(target=run)
    thread.start()

    def end() -> None:
        over.set()
        thread.join()

    try:
        yield end
    finally:
        end()
