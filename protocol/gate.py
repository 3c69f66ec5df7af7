"""Who is let in: answers ZeroMQ's questions about keys by the allow-list, and shows others out.

ZeroMQ asks once, when a connection is made, and cannot drop one later. So the gate knows the
descriptor of each connection: when a key is taken off the list, the connections from wherever it
was seen are cut, and whoever else was there connects anew.
"""

from collections import Counter
from collections.abc import Callable

import zmq

from protocol import sockets, zap
from protocol.allow_list import AllowList
from protocol.door import Door
from protocol.keys import ServerKeys
from protocol.watch import HANDSHAKE, NO_KEY, NOT_AUTHENTIC, REPLAYED

# So many refused peers are named in the log, and so many addresses remembered of a key.
MAX_NAMED = 1_000
MAX_ADDRESSES = 100
UNKNOWN_KEY, REVOKED_KEY, LIST_UNREADABLE = "unknown_key", "revoked_key", "list_unreadable"
REASONS = {
    NO_KEY: "it has no key",
    NOT_AUTHENTIC: "it has a wrong public key of this node, or its bytes were altered on the way",
    REPLAYED: "its messages came twice or in another order",
    HANDSHAKE: "it made no ZeroMQ connection",
    UNKNOWN_KEY: "key {} is not allowed",
    REVOKED_KEY: "key {} is allowed no more",
    LIST_UNREADABLE: "the allow-list cannot be read, so that nobody new is let in",
}


class Gate:
    """The keys of all sockets that one context binds. One for each context, before they bind.

    sockets: to wait for, beside those it guards; rejected: what was refused, by cause.
    """

    def __init__(
        self, context: sockets.Context, keys: ServerKeys, log: Callable[[str], None]
    ) -> None:
        """Raises KeyFileError when the allow-list cannot be used."""
        self._context = context
        self._own = keys.own
        self._log = log
        self._zap = context.socket(zmq.ROUTER)
        self._zap.bind(zap.ENDPOINT)
        self.sockets: list[sockets.Socket] = [self._zap]
        self.rejected: Counter[str] = Counter()
        self._doors: list[Door] = []
        self._named: set[tuple[str, str, bytes]] = set()
        # By key: where it was let in from.
        self._seen: dict[bytes, set[str]] = {}
        self._list = AllowList(keys.allowed, log)

    def guard(self, socket: sockets.Socket) -> None:
        """Let in whom the list allows, and nobody else; before `socket` is bound."""
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._own.secret)
        socket.setsockopt(zmq.ZAP_DOMAIN, zap.DOMAIN)
        # Without somebody who answers, nobody gets in.
        socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        door = Door(self._context, socket)
        self._doors.append(door)
        self.sockets.append(door.socket)

    def tend(self, now_ns: int) -> None:
        """Answer who knocks, count who is refused, look at the list; call it often.

        The order counts: a connection that was let in is known before its key can be revoked.
        """
        for door in self._doors:
            for cause, address in door.failures():
                self._refuse(cause, address)
        for key in self._list.tend(now_ns):
            self._show_out(self._seen.pop(key, set()))
        for envelope, empty, *request in sockets.receive_all(self._zap):
            sockets.send(self._zap, envelope, empty, *zap.reply(request, self._judge(request)))

    def _judge(self, request: list[bytes]) -> str | None:
        """The name of a peer that is let in."""
        knock = zap.read_knock(request)
        if knock is None:
            self._refuse(HANDSHAKE, "")
            return None
        # Who has the node's own secret key is the node.
        own = self._own.public
        public = own if knock.key == own.key else self._list.allowed.get(knock.key)
        if public is not own and not self._list.readable:
            self._refuse(LIST_UNREADABLE, knock.address, knock.key)
            return None
        if public is None:
            cause = REVOKED_KEY if self._list.once_allowed(knock.key) else UNKNOWN_KEY
            self._refuse(cause, knock.address, knock.key)
            return None
        seen = self._seen.setdefault(knock.key, set())
        if len(seen) < MAX_ADDRESSES:
            seen.add(knock.address)
        return public.name

    def _refuse(self, cause: str, address: str, key: bytes = b"") -> None:
        self.rejected[cause] += 1
        if (cause, address, key) in self._named or len(self._named) > MAX_NAMED:
            return
        if not (address or key) and any(cause == named for named, *_ in self._named):
            return  # perhaps one that is named already: it left before its address was asked for
        self._named.add((cause, address, key))
        if len(self._named) > MAX_NAMED:
            self._log("more peers are refused than are named here; the summary counts them")
            return
        self._log(f"refused {address or 'a peer'}: {REASONS[cause].format(key.hex())}")

    def _show_out(self, addresses: set[str]) -> None:
        everywhere = len(addresses) >= MAX_ADDRESSES
        for door in self._doors:
            door.cut(None if everywhere else addresses)
