"""Waiting for events in another thread or process."""

import time
from collections.abc import Callable

PATIENCE_S = 20.0


def until(done: Callable[[], object], patience_s: float = PATIENCE_S) -> None:
    """Wait until a function returns something true."""
    give_up_s = time.monotonic() + patience_s
    while not done():
        assert time.monotonic() < give_up_s, "it never came"
        time.sleep(0.005)
