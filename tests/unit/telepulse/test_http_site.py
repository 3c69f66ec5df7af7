import socket

import pytest

from telepulse.http_site import Site

HERE = socket.gethostname().lower()


@pytest.mark.parametrize(
    ("bound", "host", "origin"),
    [
        ("127.0.0.1", "127.0.0.1:5006", None),
        ("127.0.0.1", "LOCALHOST:5006", "http://localhost:5006"),
        ("127.0.0.1", "localhost.", None),
        ("localhost", "[::1]:5006", "http://[::1]:5006"),
        ("192.0.2.7", "192.0.2.7:5006", "http://192.0.2.7:5006"),
        ("192.0.2.7", f"{HERE}:5006", None),
        ("node7.lab", "node7.lab", None),
        ("0.0.0.0", "192.0.2.7:9100", None),
        ("::", "[2001:db8::7]:9100", None),
    ],
)
def test_a_request_under_an_own_name_is_served(bound: str, host: str, origin: str | None) -> None:
    assert Site.at(bound).refusal(host, origin) is None


@pytest.mark.parametrize(
    ("bound", "host", "origin"),
    [
        ("127.0.0.1", "evil.example:5006", None),
        ("127.0.0.1", "evil.example:5006", "http://evil.example:5006"),
        ("127.0.0.1", "127.0.0.1.evil.example", None),
        ("127.0.0.1", "localhost@evil.example", None),
        ("127.0.0.1", "127.0.0.1:5006", "http://evil.example"),
        # Another server of this machine.
        ("127.0.0.1", "127.0.0.1:5006", "http://127.0.0.1:8000"),
        ("127.0.0.1", "127.0.0.1:5006", "null"),
        ("127.0.0.1", "192.0.2.7:5006", None),
        ("192.0.2.7", "127.0.0.1:5006", None),
        ("0.0.0.0", "evil.example:9100", None),
        ("127.0.0.1", "", None),
        ("127.0.0.1", "[:5006", None),
        ("127.0.0.1", "evil\r\n\x1b[2J.example", None),
    ],
)
def test_others_are_refused_in_one_printed_line(bound: str, host: str, origin: str | None) -> None:
    refusal = Site.at(bound).refusal(host, origin)
    assert refusal
    assert refusal.isprintable()
    assert len(refusal) < 150
