import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from telepulse.view.server import PageServer

from ...nodes import free_address
from ...waiting import until


@contextmanager
def serving(telemetry: str) -> Iterator[PageServer]:
    """A page's server on a loop of its own."""
    made: list[PageServer] = []

    def serve() -> None:
        loop = asyncio.new_event_loop()
        asyncio.set_event_loop(loop)
        made.append(PageServer(telemetry, "127.0.0.1", None, print))
        made[0].run()
        loop.close()

    thread = threading.Thread(target=serve)
    thread.start()
    until(lambda: made)
    try:
        yield made[0]
    finally:
        made[0].stop()
        thread.join(20)


@pytest.fixture
def pull_session() -> Any:
    return pytest.importorskip("bokeh.client").pull_session


def test_several_may_look_and_who_leaves_is_forgotten(pull_session: Any) -> None:
    with serving(free_address()) as page:
        first, second = (pull_session(url=page.url) for _ in range(2))
        assert page.viewers == 2
        first.close()
        until(lambda: page.viewers == 1)
        second.close()
        until(lambda: page.viewers == 0)
