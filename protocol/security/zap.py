"""ZAP (RFC 27), by which ZeroMQ asks whether a key is let in: what a request says, and a reply."""

import ipaddress
from collections.abc import Sequence
from typing import NamedTuple

ENDPOINT = "inproc://zeromq.zap.01"
DOMAIN = b"telepulse"
VERSION = b"1.0"
KEY_BYTES = 32


class ZapRequest(NamedTuple):
    """Somebody who wants in: whence (empty over ipc), and with which key."""

    address: str
    key: bytes


def read_request(request: Sequence[bytes]) -> ZapRequest | None:
    """What a request asks; None for one that is no CURVE request of ours."""
    if len(request) != 7:
        return None
    version, _, domain, address, _, mechanism, key = request
    if (version, domain, mechanism) != (VERSION, DOMAIN, b"CURVE") or len(key) != KEY_BYTES:
        return None
    return ZapRequest(internet(address.decode("ascii", "replace")), key)


def reply(request: Sequence[bytes], user: str | None) -> list[bytes]:
    """The answer to a request: `user` is let in, None is not."""
    number = request[1] if len(request) > 1 else b""
    if user is None:
        return [VERSION, number, b"400", b"not allowed", b"", b""]
    return [VERSION, number, b"200", b"", user.encode("ascii"), b""]


def internet(address: str) -> str:
    """A peer's address as ZeroMQ says it, where it is one of a network; else empty: over ipc it
    names user and process."""
    try:
        ipaddress.ip_address(address)
    except ValueError:
        return ""
    return address
