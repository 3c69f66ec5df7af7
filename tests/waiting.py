"""Waiting for what happens in another thread or process."""

import time
from collections.abc import Callable

PATIENCE_S = 20.0


def until(done: Callable[[], object]) -> None:
    """Look again and again until it is done."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not done():
        assert time.monotonic() < give_up_s, "it never came"
        time.sleep(0.005)
