"""Authentication of peers by the allow-list, and cutting of the connections of revoked keys.

libzmq authenticates a CURVE connection by ZAP (RFC 27): it sends a request with the peer's key to a
socket of this process, once, when the connection is made. It cannot drop the connection later.
So the authenticator records the addresses of each key. When a key is revoked, all connections
from its addresses are cut; peers whose key is still allowed reconnect by themselves.

TCP connections can be opened without any key, so the authenticator bounds their number too.
`zmq.auth` does not suffice for this (docs/decisions/0031-zmq-auth-is-not-enough.md).
"""

import logging
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import zmq

from protocol import sockets
from protocol.host.process import connections_that_fit
from protocol.refusals import CONNECTIONS, HANDSHAKE, TOO_MANY
from protocol.security.budgets import ConnectionBudget
from protocol.security.connection_table import ConnectionTable, network_address
from protocol.security.keys import KEY_BYTES
from protocol.security.link_keys import ServerKeys

logger = logging.getLogger(__name__)

ZAP_ENDPOINT = "inproc://zeromq.zap.01"
ZAP_DOMAIN = b"telepulse"
ZAP_VERSION = b"1.0"
# Number of refused peers that are named in the log, and of addresses that are stored for a key.
MAX_NAMED, MAX_ADDRESSES = 1_000, 100
EVERYWHERE = "everywhere"
# Number of requests answered in a call; with the key exchanges, they take some 0.3 ms of a loop.
MAX_ANSWERS = 16


class ZapRequest(NamedTuple):
    """Address ("" over ipc) and public key of a peer that connects."""

    address: str
    key: bytes


def decode_zap_request(parts: Sequence[bytes]) -> ZapRequest | None:
    """Decode a ZAP request; return None unless it is a CURVE request of `ZAP_DOMAIN`."""
    if len(parts) != 7:
        return None
    version, _, domain, address, _, mechanism, key = parts
    if (version, domain, mechanism) != (ZAP_VERSION, ZAP_DOMAIN, b"CURVE") or len(key) != KEY_BYTES:
        return None
    return ZapRequest(network_address(address.decode("ascii", "replace")), key)


def encode_zap_reply(request: Sequence[bytes], user: str | None) -> list[bytes]:
    """Encode the reply to a ZAP request; a `user` is allowed, None is refused."""
    number = request[1] if len(request) > 1 else b""
    if user is None:
        return [ZAP_VERSION, number, b"400", b"not allowed", b"", b""]
    return [ZAP_VERSION, number, b"200", b"", user.encode("ascii"), b""]


class Authenticator:
    """Authentication for the sockets that are passed to `protect`, before they bind.

    With keys, the allow-list decides; without, every peer may connect. In both cases the number of
    connections is bounded, so that a peer that connects repeatedly does not affect the others.
    most: greatest number of connections, by default as many as this process may open.

    Attributes
    ----------
    sockets : list of zmq.Socket
        Sockets to wait for, besides the protected ones.
    rejected : Counter
        Refusals by cause.
    """

    def __init__(
        self, context: sockets.Context, keys: ServerKeys | None, most: int | None = None
    ) -> None:
        self._context = context
        self.sockets: list[sockets.Socket] = []
        self.rejected: Counter[str] = Counter()
        self._tables: list[ConnectionTable] = []
        self._budget = ConnectionBudget(connections_that_fit() if most is None else most)
        self._named: set[tuple[str, str, bytes]] = set()
        # Addresses from which each key was accepted.
        self._addresses: dict[bytes, set[str]] = {}
        self._to_cut: set[str] = set()
        self._keys = keys
        if keys is not None:
            self._own, self._list = keys.own.public, keys.allow_list
            self._zap = context.socket(zmq.ROUTER)
            self._zap.bind(ZAP_ENDPOINT)
            self.sockets.append(self._zap)

    def protect(self, socket: sockets.Socket) -> None:
        """Require a key of the allow-list, if there are keys, and count the socket's connections.

        Call this before the socket is bound.
        """
        if self._keys is not None:
            socket.setsockopt(zmq.CURVE_SERVER, 1)
            socket.setsockopt(zmq.CURVE_SECRETKEY, self._keys.own.secret)
            socket.setsockopt(zmq.ZAP_DOMAIN, ZAP_DOMAIN)
            # Refuse all peers if there is no ZAP handler.
            socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        table = ConnectionTable(self._context, socket)
        self._tables.append(table)
        self.sockets.append(table.socket)

    def poll(self, now_ns: int) -> None:
        """Answer requests, count refusals, read a changed list, cut connections; call it often.

        The work of one call is bounded, however many peers connect.
        """
        for table in self._tables:
            for cause, address in table.failures():
                # Without keys no peer is refused, and an early disconnection is no failure.
                if self._keys is not None:
                    self._refuse(cause, address)
        for address in self._budget.enforce(self._tables, now_ns):
            self._refuse(TOO_MANY, address)
        if self._keys is not None:
            self._cut_revoked(now_ns)
            for envelope, empty, *request in sockets.receive_multipart(self._zap, MAX_ANSWERS):
                user = self._user_of(request)
                sockets.send(self._zap, envelope, empty, *encode_zap_reply(request, user))

    def _cut_revoked(self, now_ns: int) -> None:
        for key in self._list.poll(now_ns):
            addresses = self._addresses.pop(key, set())
            self._to_cut |= addresses if len(addresses) < MAX_ADDRESSES else {EVERYWHERE}
        if self._to_cut:
            for table in self._tables:
                table.cut(None if EVERYWHERE in self._to_cut else self._to_cut)
            # A table that is behind may not yet list a connection that was accepted earlier.
            if not any(table.behind for table in self._tables):
                self._to_cut.clear()

    def _user_of(self, parts: list[bytes]) -> str | None:
        """Return the name of the peer that may connect; count the refusal of any other."""
        request = decode_zap_request(parts)
        if request is None:
            self._refuse(HANDSHAKE, "")
            return None
        if request.key == self._own.key:  # a process of this node itself, such as its screen
            peer = self._own
        elif cause := self._list.cause_to_refuse(request.key):
            self._refuse(cause, request.address, request.key)
            return None
        else:
            peer = self._list.allowed[request.key]
        addresses = self._addresses.setdefault(request.key, set())
        if len(addresses) < MAX_ADDRESSES:
            addresses.add(request.address)
        return peer.name

    def _refuse(self, cause: str, address: str, key: bytes = b"") -> None:
        self.rejected[cause] += 1
        if (cause, address, key) in self._named or len(self._named) > MAX_NAMED:
            return
        if not (address or key) and any(cause == named for named, *_ in self._named):
            return  # perhaps a peer that is named already and left before its address was read
        self._named.add((cause, address, key))
        if len(self._named) > MAX_NAMED:
            logger.warning("more peers are refused than are named here; the summary counts them")
            return
        reason = CONNECTIONS[cause].at_server.format(key=key.hex())
        logger.warning(f"refused {address or 'a peer'}: {reason}")
