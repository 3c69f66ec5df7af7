"""Waiting for what happens in another thread or process."""

import time
from collections.abc import Callable

PATIENCE_S = 20.0


def until(done: Callable[[], object], patience_s: float = PATIENCE_S) -> None:
    """Look again and again until it is done."""
    give_up_s = time.monotonic() + patience_s
    while not done():
        assert time.monotonic() < give_up_s, "it never came"
        time.sleep(0.005)
