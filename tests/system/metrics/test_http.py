import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from urllib.error import URLError
from urllib.request import urlopen

import pytest
from prometheus_client import CollectorRegistry, make_wsgi_app

from telepulse.metrics import server as http
from telepulse.metrics.server import MAX_REQUESTS, MetricsHTTPServer
from tests.support.waiting import PATIENCE_S, until


@contextmanager
def serving() -> Iterator[MetricsHTTPServer]:
    server = MetricsHTTPServer("127.0.0.1", 0, make_wsgi_app(CollectorRegistry()))
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def answers(server: MetricsHTTPServer) -> bool:
    try:
        with urlopen(f"http://127.0.0.1:{server.server_port}/", timeout=PATIENCE_S) as answer:
            return bool(answer.status == 200)
    except (URLError, OSError):
        return False


def test_connections_that_send_nothing_are_few_and_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http._Handler, "timeout", 1.0)
    with serving() as server, ExitStack() as held:
        threads = threading.active_count()
        for _ in range(5 * MAX_REQUESTS):
            held.enter_context(socket.create_connection(("127.0.0.1", server.server_port)))
        assert threading.active_count() - threads <= MAX_REQUESTS
        until(lambda: answers(server))


def test_the_server_binds_where_names_are_not_found(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "getfqdn", lambda *_: pytest.fail("a name was looked up"))
    with serving() as server:
        assert answers(server)
