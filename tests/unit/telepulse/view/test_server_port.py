import gc
import socket

import pytest

from telepulse.view.server import bind


def test_a_port_that_is_taken_leaves_no_socket_open(monkeypatch: pytest.MonkeyPatch) -> None:
    taken, port = bind("127.0.0.2", 0)
    at = socket.AF_INET, socket.SOCK_STREAM, 6, ""
    found = [(*at, ("127.0.0.2", port)), (*at, ("127.0.0.1", port))]
    monkeypatch.setattr(socket, "getaddrinfo", lambda *_, **__: found)
    with pytest.raises(OSError, match="in use"):
        bind("localhost", port)
    found.pop(0)
    free, same = bind("localhost", port)
    assert same == port
    monkeypatch.undo()
    for listening in (*taken, *free):
        listening.close()
    # A socket that is left to be collected is a warning, and so an error.
    gc.collect()
