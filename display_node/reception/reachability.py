"""Why a sensing node is not reached: nobody listens, no route, no answer, or no node.

While no host accepts, ZeroMQ tries to connect without end and reports no reason. So a display that
waits requests a plain TCP connection now and then, and reads the result later: no call blocks.
"""

import errno
import socket

from protocol.host.descriptors import await_writable
from protocol.refusals import Reason

# A probe that a sensing node accepts is a broken handshake in its account, so probes are rare.
FIRST_NS, AGAIN_NS = 1_000_000_000, 5_000_000_000
# The kernel repeats a request after 1 and 3 s.
SILENT_NS = 4_000_000_000
# A node completes its handshake within some round trips.
NO_NODE_NS = 2_000_000_000
# Connections that are silent are made anew every few seconds; a shorter gap is no loss.
FLICKER_NS = 1_000_000_000
# Windows has numbers of its own.
_PENDING = {errno.EINPROGRESS, errno.EWOULDBLOCK, errno.EALREADY, errno.EAGAIN, 10_035}
_NO_ROUTE = {errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN, 10_051, 10_065}
# What a probe finds; the address follows.
NOBODY = Reason("nobody listens at", "start the sensing node there, or check the address")
UNROUTED, SILENT = Reason("no route to"), Reason("no answer from")


class ConnectionRequest:
    """A request for a connection to a tcp:// or ipc:// address with an IP address as its host."""

    def __init__(self, place: str, now_ns: int) -> None:
        self.asked_ns = now_ns
        scheme, _, where = place.partition("://")
        if scheme == "ipc":
            self._socket = socket.socket(socket.AF_UNIX)
            target: str | tuple[str, int] = where
        else:
            host, _, port = where.rpartition(":")
            host = host.strip("[]")
            self._socket = socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET)
            target = host, int(port)
        self._socket.setblocking(False)
        self._error = self._socket.connect_ex(target)

    def result(self) -> int | None:
        """Return the error's number, 0 for an accepted request; None while there is none."""
        if self._error in _PENDING:
            if not await_writable(self._socket.fileno(), 0.0):
                return None
            self._error = self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        return self._error

    def close(self) -> None:
        """Close the connection, or withdraw the request."""
        self._socket.close()


class Reachability:
    """State of the attempts to reach one address, which every reason names as the user gave it."""

    def __init__(self, address: str) -> None:
        self._address = address
        self._probe: ConnectionRequest | None = None
        self._probe_due_ns: int | None = None
        self._found: Reason | None = None
        # ZeroMQ's attempts: at the begin of this wait, and so far.
        self._attempts_before = self._attempts = 0
        # Times of a host's first and of its last answer; None while none answers.
        self._answers_ns: int | None = None
        self._answered_ns = 0

    def poll(self, now_ns: int, place: str | None, answered: bool, attempts: int) -> None:
        """Note the state of ZeroMQ's connection, and probe while there is none; call it often.

        place: the address with an IP address as its host; None while that is not known, or no probe
        is wanted. answered: whether a host has accepted the connection. attempts: failed ones of
        ZeroMQ so far.
        """
        self._attempts = attempts
        if answered:
            self.close()
            self._answered_ns, self._probe_due_ns, self._found = now_ns, None, None
            if self._answers_ns is None:
                self._answers_ns = now_ns
            return
        if self._answers_ns is not None and now_ns - self._answered_ns < FLICKER_NS:
            return
        self._answers_ns = None
        if self._probe_due_ns is None:
            self._probe_due_ns, self._attempts_before = now_ns + FIRST_NS, attempts
        if self._probe is not None:
            self._read(self._probe, now_ns)
        elif place is not None and now_ns >= self._probe_due_ns:
            self._probe_due_ns = now_ns + AGAIN_NS
            self._probe = ConnectionRequest(place, now_ns)

    def reason(self, now_ns: int, established: bool = False, unknown_host: str = "") -> Reason:
        """Return what is waited for, or why it does not come.

        established: whether ZeroMQ's handshake has succeeded. unknown_host: why the look-up of the
        host's name failed, if it did.
        """
        if established:
            return Reason(f"{self._address} is connected, but sends nothing")
        if self._answers_ns is not None and now_ns - self._answers_ns >= NO_NODE_NS:
            return Reason(f"{self._address} answers, but is no node")
        if unknown_host:
            return Reason(unknown_host)
        if self._found is None:
            return Reason(f"connecting to {self._address}")
        attempts = self._attempts - self._attempts_before
        often = f", refused {attempts} times" if self._found is NOBODY and attempts > 1 else ""
        return Reason(f"{self._found.text} {self._address}{often}", self._found.further)

    def close(self) -> None:
        """Withdraw the probe."""
        if self._probe is not None:
            self._probe.close()
            self._probe = None

    def _read(self, probe: ConnectionRequest, now_ns: int) -> None:
        error = probe.result()
        if error is None:
            if now_ns - probe.asked_ns < SILENT_NS:
                return
            self._found = SILENT
        elif error in _NO_ROUTE:
            self._found = UNROUTED
        else:
            # An accepted request is ZeroMQ's to report.
            self._found = NOBODY if error else None
        self.close()
