"""ZAP (RFC 27): libzmq's request to authenticate a client by its key, and the reply to it.

libzmq sends the request within the server's process, once for each connection. Of the reply, a
refused client receives the status alone, as the value of its event HANDSHAKE_FAILED_AUTH.
"""

from collections.abc import Sequence
from typing import NamedTuple

from protocol.refusals import LIST_UNREADABLE
from protocol.security.keys import KEY_BYTES
from protocol.sockets import network_address

ENDPOINT = "inproc://zeromq.zap.01"
DOMAIN = b"telepulse"
VERSION = b"1.0"
MAY_CONNECT, REFUSED, CANNOT_DECIDE = 200, 400, 500


class ZapRequest(NamedTuple):
    """Address ("" over ipc) and public key of a client that connects."""

    address: str
    key: bytes


def decode_request(parts: Sequence[bytes]) -> ZapRequest | None:
    """Decode a request; return None unless it is a CURVE request of `DOMAIN`."""
    if len(parts) != 7:
        return None
    version, _, domain, address, _, mechanism, key = parts
    if (version, domain, mechanism) != (VERSION, DOMAIN, b"CURVE") or len(key) != KEY_BYTES:
        return None
    return ZapRequest(network_address(address.decode("ascii", "replace")), key)


def encode_reply(request: Sequence[bytes], cause: str | None) -> list[bytes]:
    """Encode the reply to a request: the client may connect, or is refused for a cause."""
    number = request[1] if len(request) > 1 else b""
    status, text = MAY_CONNECT, b""
    if cause is not None:
        # A list that cannot be read is no verdict on the key, and the client must know that.
        status = CANNOT_DECIDE if cause == LIST_UNREADABLE else REFUSED
        text = cause.encode("ascii")
    return [VERSION, number, b"%d" % status, text, b"", b""]
