"""Authentication of peers by the allow-list, and cutting of the connections of revoked keys.

libzmq requests the authentication of a connection once, when it is made (`zap`), and cannot drop it
later. So the authenticator records the addresses of each key. When a key is revoked, all
connections from its addresses are cut; peers whose key is still allowed reconnect by themselves.

TCP connections can be opened without any key, so the authenticator bounds their number too.
`zmq.auth` does not suffice for this (docs/decisions/0031-zmq-auth-is-not-enough.md).
"""

import logging
from collections import Counter

import zmq

from protocol import sockets
from protocol.host.process import connections_that_fit
from protocol.refusals import CONNECTIONS, HANDSHAKE, TOO_MANY
from protocol.security import zap
from protocol.security.budgets import TokenBucket
from protocol.security.connection_table import ConnectionBudget, ConnectionTable
from protocol.security.link_keys import ServerKeys

logger = logging.getLogger(__name__)

# Number of refused peers that are named in the log, and of addresses that are stored for a key.
MAX_NAMED, MAX_ADDRESSES = 1_000, 100
EVERYWHERE = "everywhere"
# An allowed client that connects again after a cut breaks off some 6 handshakes, and tries whether
# the node is reached. These are no refusals, up to this number at once and per second.
OWN_BREAKS, OWN_BREAKS_PER_S = 20.0, 1.0
# Number of requests answered in a call; with the key exchanges, they take some 0.3 ms of a loop.
MAX_ANSWERS = 16


class AllowedClient:
    """Client whose key was accepted: its addresses, and the handshakes that it breaks off."""

    def __init__(self) -> None:
        self.addresses: set[str] = set()
        self._breaks = TokenBucket(OWN_BREAKS_PER_S, OWN_BREAKS)

    def may_break(self, address: str, now_ns: int) -> bool:
        """Return whether it may have broken off a handshake from an address.

        The address is "" where the connection ended before it could be read.
        """
        return (not address or address in self.addresses) and self._breaks.take(now_ns)


class Authenticator:
    """Authentication for the sockets that are passed to `protect`, before they bind.

    With keys, the allow-list decides; without, every peer may connect. In both cases the number of
    connections is bounded, so that a peer that connects repeatedly does not affect the others.
    most: greatest number of connections, by default as many as this process may open.

    Attributes
    ----------
    own_sockets : list of zmq.Socket
        Sockets to wait for, besides the protected ones: the authentication requests, and the events
        of each protected socket.
    rejected : Counter
        Refusals by cause; handshakes that allowed clients break off as they connect again are
        none.
    """

    def __init__(
        self, context: sockets.Context, keys: ServerKeys | None, most: int | None = None
    ) -> None:
        self._context = context
        self.own_sockets: list[sockets.Socket] = []
        self.rejected: Counter[str] = Counter()
        self._tables: list[ConnectionTable] = []
        self._budget = ConnectionBudget(connections_that_fit() if most is None else most)
        # Cause, address and key of the refusals that were logged.
        self._named: set[tuple[str, str, bytes]] = set()
        # By key.
        self._allowed: dict[bytes, AllowedClient] = {}
        self._to_cut: set[str] = set()
        self._keys = keys
        if keys is not None:
            self._node_key, self._list = keys.pair.public.key, keys.allow_list
            self._zap = context.socket(zmq.ROUTER)
            self._zap.bind(zap.ENDPOINT)
            self.own_sockets.append(self._zap)

    def protect(self, socket: sockets.Socket) -> None:
        """Require a key of the allow-list, if there are keys, and count the socket's connections.

        Call this before the socket is bound. libzmq encrypts, and refuses every client for which
        no reply of `poll` comes.
        """
        if self._keys is not None:
            socket.setsockopt(zmq.CURVE_SERVER, 1)
            socket.setsockopt(zmq.CURVE_SECRETKEY, self._keys.pair.secret)
            socket.setsockopt(zmq.ZAP_DOMAIN, zap.DOMAIN)
            socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        table = ConnectionTable(self._context, socket)
        self._tables.append(table)
        self.own_sockets.append(table.socket)

    def poll(self, now_ns: int) -> None:
        """Answer requests, count refusals, read a changed list, cut connections; call it often.

        The work of one call is bounded, however many peers connect.
        """
        for table in self._tables:
            for failure, address in table.failures():
                # Without keys no peer is refused, and an early disconnection is no failure.
                if self._keys is None:
                    continue
                if failure != HANDSHAKE or not self._broken_by_allowed(address, now_ns):
                    self._refuse(failure, address)
        for address in self._budget.enforce(self._tables, now_ns):
            self._refuse(TOO_MANY, address)
        if self._keys is not None:
            self._cut_revoked(now_ns)
            for envelope, empty, *request in sockets.receive_multipart(self._zap, MAX_ANSWERS):
                cause = self._cause_to_refuse(request)
                sockets.send(self._zap, envelope, empty, *zap.encode_reply(request, cause))

    def _cut_revoked(self, now_ns: int) -> None:
        for key in self._list.poll(now_ns):
            addresses = self._allowed.pop(key, AllowedClient()).addresses
            self._to_cut |= addresses if len(addresses) < MAX_ADDRESSES else {EVERYWHERE}
        if self._to_cut:
            for table in self._tables:
                table.cut_from(None if EVERYWHERE in self._to_cut else self._to_cut)
            # A table that is behind may not yet list a connection that was accepted earlier.
            if not any(table.behind for table in self._tables):
                self._to_cut.clear()

    def _cause_to_refuse(self, parts: list[bytes]) -> str | None:
        """Return the cause to refuse a ZAP request, which is counted; None where it is allowed."""
        request = zap.decode_request(parts)
        if request is None:
            self._refuse(HANDSHAKE, "")
            return HANDSHAKE
        # A process of this node itself, such as its screen, has the node's own key.
        if request.key != self._node_key and (cause := self._list.cause_to_refuse(request.key)):
            self._refuse(cause, request.address, request.key)
            return cause
        addresses = self._allowed.setdefault(request.key, AllowedClient()).addresses
        if len(addresses) < MAX_ADDRESSES:
            addresses.add(request.address)
        return None

    def _broken_by_allowed(self, address: str, now_ns: int) -> bool:
        return any(client.may_break(address, now_ns) for client in self._allowed.values())

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
        client = self._list.describe(key) if key else ""
        reason = CONNECTIONS[cause].at_server.format(client=client)
        logger.warning(f"refused {address or 'a peer'}: {reason}")
