"""Admission of peers: answers ZeroMQ's questions about keys by the allow-list, and cuts others off.

ZeroMQ asks once, when a connection is made, and cannot drop one later. So the gate knows the
descriptor of each connection: when a key is taken off the list, the connections from wherever it
was seen are cut, and whoever else was there connects anew.

A stranger, whom the list does not let in, connects all the same: the gate bounds that, too.
"""

from collections import Counter
from collections.abc import Callable

import zmq

from protocol import sockets
from protocol.host.process import connections_that_fit
from protocol.security import zap
from protocol.security.allow_list import AllowList
from protocol.security.connection_budget import ConnectionBudget
from protocol.security.connection_table import ConnectionTable
from protocol.security.keys import ServerKeys
from protocol.security.socket_monitor import HANDSHAKE, NO_KEY, NOT_AUTHENTIC, REPLAYED

# So many refused peers are named in the log, and so many addresses remembered of a key.
MAX_NAMED = 1_000
MAX_ADDRESSES = 100
EVERYWHERE = "everywhere"
TOO_MANY = "too_many_connections"
# So many requests are answered a call, each after a key exchange: some 0.3 ms of a loop.
MAX_ANSWERS = 16
UNKNOWN_KEY, REVOKED_KEY, LIST_UNREADABLE = "unknown_key", "revoked_key", "list_unreadable"
REASONS = {
    NO_KEY: "it has no key",
    NOT_AUTHENTIC: "it has a wrong public key of this node, or its bytes were altered on the way",
    REPLAYED: "its messages came twice or in another order",
    HANDSHAKE: "it made no ZeroMQ connection",
    UNKNOWN_KEY: "key {} is not allowed",
    REVOKED_KEY: "key {} is allowed no more",
    LIST_UNREADABLE: "the allow-list cannot be read, so that nobody new is let in",
    TOO_MANY: "more connections than this node has files for; it keeps those that came before",
}


class Authenticator:
    """Admission to all sockets that one context binds. One for each context, before they bind.

    With keys the allow-list decides; without, everybody may come. In either case the connections
    are bounded, so that one who connects again and again costs the others nothing.

    sockets: to wait for, beside those it guards; rejected: what was refused, by cause.
    """

    def __init__(
        self,
        context: sockets.Context,
        keys: ServerKeys | None,
        log: Callable[[str], None],
        most: int | None = None,
    ) -> None:
        """keys: None where the link does without. most: connections, together; None: for which
        this process has files.

        Raises KeyFileError when the allow-list cannot be used.
        """
        self._context = context
        self._log = log
        self.sockets: list[sockets.Socket] = []
        self.rejected: Counter[str] = Counter()
        self._doors: list[ConnectionTable] = []
        self._budget = ConnectionBudget(connections_that_fit() if most is None else most)
        self._named: set[tuple[str, str, bytes]] = set()
        # By key: where it was let in from.
        self._seen: dict[bytes, set[str]] = {}
        self._to_show_out: set[str] = set()
        self._keys = keys
        if keys is not None:
            self._list = AllowList(keys.allowed, log)
            self._zap = context.socket(zmq.ROUTER)
            self._zap.bind(zap.ENDPOINT)
            self.sockets.append(self._zap)

    def guard(self, socket: sockets.Socket) -> None:
        """Admit to `socket` the keys of the allow-list alone; call it before `socket` is bound."""
        if self._keys is not None:
            socket.setsockopt(zmq.CURVE_SERVER, 1)
            socket.setsockopt(zmq.CURVE_SECRETKEY, self._keys.own.secret)
            socket.setsockopt(zmq.ZAP_DOMAIN, zap.DOMAIN)
            # Without somebody who answers, nobody gets in.
            socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        door = ConnectionTable(self._context, socket)
        self._doors.append(door)
        self.sockets.append(door.socket)

    def tend(self, now_ns: int) -> None:
        """Answer who knocks, count who is refused, look at the list; call it often.

        What it does in a call is bounded, however many knock.
        """
        for door in self._doors:
            for cause, address in door.failures():
                # Without keys nobody is refused; who hangs up early is no concern of anybody.
                if self._keys is not None:
                    self._refuse(cause, address)
        for address in self._budget.enforce(self._doors, now_ns):
            self._refuse(TOO_MANY, address)
        if self._keys is not None:
            self._tend_keys(self._keys, now_ns)

    def _tend_keys(self, keys: ServerKeys, now_ns: int) -> None:
        for key in self._list.tend(now_ns):
            addresses = self._seen.pop(key, set())
            self._to_show_out |= addresses if len(addresses) < MAX_ADDRESSES else {EVERYWHERE}
        if self._to_show_out:
            everywhere = EVERYWHERE in self._to_show_out
            for door in self._doors:
                door.cut(None if everywhere else self._to_show_out)
            # Of a connection that was let in, a door that is behind may not know yet.
            if not any(door.behind for door in self._doors):
                self._to_show_out.clear()
        for envelope, empty, *request in sockets.receive_all(self._zap, MAX_ANSWERS):
            user = self._judge(keys, request)
            sockets.send(self._zap, envelope, empty, *zap.reply(request, user))

    def _judge(self, keys: ServerKeys, request: list[bytes]) -> str | None:
        """The name of a peer that is let in."""
        knock = zap.read_request(request)
        if knock is None:
            self._refuse(HANDSHAKE, "")
            return None
        # Who has the node's own secret key is the node.
        own = keys.own.public
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
