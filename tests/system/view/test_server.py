import asyncio
import re
import socket
import threading
from collections.abc import Iterator
from contextlib import closing, contextmanager
from http.client import HTTPConnection
from urllib.parse import urlsplit

import pytest

from telepulse.view import server
from telepulse.view.server import PageServer
from tests.support.nodes import free_address
from tests.support.waiting import PATIENCE_S, until


@contextmanager
def serving(telemetry: str) -> Iterator[PageServer]:
    """Run a page's server in a thread."""
    made: list[PageServer] = []

    def serve() -> None:
        loop = asyncio.new_event_loop()
        asyncio.set_event_loop(loop)
        made.append(PageServer(telemetry, "127.0.0.1", None))
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


PATHS = ("/", "/autoload.js?bokeh-autoload-element=1", "/metadata", "/static/js/bokeh.min.js")


def get(page: PageServer, path: str, **headers: str) -> tuple[int, str]:
    """Return status and body of a request, under the page's own name unless headers differ."""
    connection = HTTPConnection("127.0.0.1", urlsplit(page.url).port, timeout=PATIENCE_S)
    with closing(connection):
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


def websocket(page: PageServer, token: str, **headers: str) -> tuple[str, socket.socket]:
    """Return the status line of a request for the page's websocket, and its connection."""
    own = urlsplit(page.url).netloc
    lines = {
        "Host": own,
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": "MDEyMzQ1Njc4OWFiY2RlZg==",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Protocol": f"bokeh, {token}",
    } | headers
    connection = socket.create_connection(("127.0.0.1", urlsplit(page.url).port or 0), PATIENCE_S)
    text = "".join(f"{name}: {value}\r\n" for name, value in lines.items())
    connection.sendall(f"GET /ws HTTP/1.1\r\n{text}\r\n".encode())
    return connection.recv(65_536).decode("utf-8", "replace").splitlines()[0], connection


def token_of(page: PageServer) -> str:
    """Open the page and return the token that its websocket needs."""
    status, body = get(page, "/")
    assert status == 200, body
    found = re.search(r'"token":\s*"([^"]+)"', body)
    assert found is not None
    return found[1]


def test_another_site_is_served_neither_page_nor_pulse(logged: list[str]) -> None:
    with serving(free_address()) as page:
        port = urlsplit(page.url).port
        # The name of another site that resolves to this machine.
        evil = f"evil.example:{port}"
        for headers in ({"Host": evil}, {"Host": evil, "Origin": f"http://{evil}"}):
            for path in PATHS:
                status, body = get(page, path, **headers)
                assert (status, body.count("\n")) == (403, 1), (path, headers, body)
        status, _ = get(page, "/", Origin="http://evil.example")
        assert status == 403
        token = token_of(page)
        for headers in ({"Host": evil}, {"Host": evil, "Origin": f"http://{evil}"}):
            line, connection = websocket(page, token, **headers)
            connection.close()
            assert " 403 " in line, headers
        line, connection = websocket(page, token, Origin=page.url)
        connection.close()
        assert " 101 " in line
    assert len(logged) == 1
    assert "evil.example" in logged[0]


def test_pages_are_few_and_those_that_do_not_read_are_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Few, so that a busy machine opens them all before the first is closed.
    monkeypatch.setattr(server, "MAX_VIEWERS", 3)
    monkeypatch.setattr(server, "PING_EVERY_S", 2.0)
    monkeypatch.setattr(server, "OPENED_AT_ONCE", 100)
    with serving(free_address()) as page:
        held = [websocket(page, token_of(page)) for _ in range(server.MAX_VIEWERS)]
        assert all(" 101 " in line for line, _ in held)
        status, body = get(page, "/")
        assert (status, body.count("\n")) == (503, 1)
        # None of them answers a ping.
        until(lambda: not page._server.get_sessions())
        assert get(page, "/")[0] == 200
        for _, connection in held:
            connection.close()


def test_pages_that_are_opened_again_and_again_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    # However long a busy machine takes for the pages.
    monkeypatch.setattr(server, "OPENED_PER_S", 1e-3)
    with serving(free_address()) as page:
        statuses = [get(page, "/")[0] for _ in range(2 * server.MAX_VIEWERS)]
    assert statuses[: server.OPENED_AT_ONCE] == [200] * server.OPENED_AT_ONCE
    assert statuses.count(503) >= server.MAX_VIEWERS
