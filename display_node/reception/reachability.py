"""Why a port of a sensing node is not reached: nobody listens, no route, no answer, or no node.

While no host accepts, ZeroMQ tries to connect without end and reports no reason, and it reports
nothing of a program that is no node. So a display that waits requests a plain TCP connection now
and then, greets as ZeroMQ does, and reads the result later: no call blocks.
"""

import errno
import os
import re
import socket
from typing import NamedTuple

from protocol.host.descriptors import await_writable
from protocol.refusals import Reason
from pulse_sensors.samples import quoted

# A probe that a sensing node accepts is a broken handshake in its account, so probes are rare.
FIRST_NS, AGAIN_NS = 1_000_000_000, 5_000_000_000
# The kernel repeats a request after 1 and 3 s.
SILENT_NS = 4_000_000_000
# Connections that are silent are made anew every few seconds; a shorter gap is no loss.
FLICKER_NS = 1_000_000_000
# Windows has numbers of its own.
_PENDING = {errno.EINPROGRESS, errno.EWOULDBLOCK, errno.EALREADY, errno.EAGAIN, 10_035}
_NO_ROUTE = {errno.ENETUNREACH, errno.EHOSTUNREACH, errno.ENETDOWN, 10_051, 10_065}
# Of a host that was asked; an ipc address without its file has no listener either.
_REFUSED = {errno.ECONNREFUSED, errno.ENOENT, 10_061}
# Greeting of ZMTP 3.0 without security, and an empty line, which a server of lines answers.
GREETING = b"\xff" + 8 * b"\0" + b"\x7f" + b"\x03\0NULL".ljust(54, b"\0") + b"\r\n\r\n"
_ZEROMQ = re.compile(rb"\xff.{8}\x7f", re.DOTALL)
_KIND = re.compile(rb"Socket-Type\0\0\0.([A-Z]+)", re.DOTALL)
_READ_BYTES = 256
# Kinds of sockets at the ports of a sensing node.
DATA_KINDS, CONTROL_KINDS = ("XPUB", "PUB"), ("ROUTER",)


class Finding(NamedTuple):
    """Result of a probe: words around an address, words behind one of two ports, and advice.

    is_program: whether the answer of another program was seen.
    """

    at_address: str
    at_port: str
    further: str = ""
    is_program: bool = False


NOBODY = Finding(
    "nobody listens at {}", "is refused", "start the sensing node there, or check the address"
)
UNROUTED, SILENT = (
    Finding("no route to {}", "has no route"),
    Finding("no answer from {}", "is not answered"),
)
MUTE = Finding(
    "{} accepts connections, but does not answer",
    "is accepted, but not answered",
    "its program is suspended or overloaded, or is no node",
)
BREAKS_OFF = Finding("{} breaks off as soon as it is connected", "breaks off at once")
NO_DATA = Finding(
    "{} speaks ZeroMQ, but serves no data",
    "serves no data",
    "give the port of the data, which is one below that of control",
    is_program=True,
)
# Found where no host has answered.
_UNANSWERED = (NOBODY, UNROUTED, SILENT)


class ConnectionRequest:
    """A request for a connection to a tcp:// or ipc:// address with an IP address as its host."""

    def __init__(self, place: str, now_ns: int) -> None:
        self.asked_ns = now_ns
        self._greeted, self._answer = False, b""
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

    def answer(self) -> tuple[bytes, bool]:
        """Greet the program that has accepted; return its bytes and whether it broke off."""
        try:
            if not self._greeted:
                self._greeted = self._socket.send(GREETING) > 0
            received = self._socket.recv(_READ_BYTES)
        except BlockingIOError:
            return self._answer, False
        except OSError:
            return self._answer, True
        self._answer += received
        return self._answer, not received

    def close(self) -> None:
        """Close the connection, or withdraw the request."""
        self._socket.close()


class Reachability:
    """State of the attempts to reach one port of an address, which the user gave.

    address: of the port. kinds: of ZeroMQ's sockets that belong to the port. found: what the last
    probe has found; None where a node answers, or nothing is known.
    """

    def __init__(self, address: str, kinds: tuple[str, ...] = DATA_KINDS) -> None:
        self.address, self._kinds = address, kinds
        self._probe: ConnectionRequest | None = None
        self._probe_due_ns: int | None = None
        self.found: Finding | None = None
        # Probes in a row that were greeted by a node with keys.
        self._greeted = 0
        # ZeroMQ's attempts: at the begin of this wait, and so far.
        self._attempts_before = self._attempts = 0
        # Time of the last poll with a connection of ZeroMQ's; None before any.
        self._up_ns: int | None = None

    def poll(
        self, now_ns: int, place: str | None, connected: bool, established: bool, attempts: int
    ) -> None:
        """Note the state of ZeroMQ's connection, and probe while there is none; call it often.

        place: the address with an IP address as its host; None while that is not known, or no probe
        is wanted. connected: whether a host has accepted the connection. established: whether its
        handshake has succeeded. attempts: failed ones of ZeroMQ so far.
        """
        self._attempts = attempts
        if established:
            self.close()
            self._up_ns, self._probe_due_ns, self.found, self._greeted = now_ns, None, None, 0
            return
        if self.is_up(now_ns):
            return
        if connected and self.found in _UNANSWERED:
            self._probe_due_ns = self.found = None
        if self._probe_due_ns is None:
            self._probe_due_ns, self._attempts_before = now_ns + FIRST_NS, attempts
        if self._probe is not None:
            self._read(self._probe, now_ns)
        elif place is not None and now_ns >= self._probe_due_ns:
            self._probe_due_ns = now_ns + AGAIN_NS
            self._probe = ConnectionRequest(place, now_ns)

    def is_up(self, now_ns: int) -> bool:
        """Return whether ZeroMQ is connected, or was a moment ago."""
        return self._up_ns is not None and now_ns - self._up_ns < FLICKER_NS

    def reason(self) -> Reason:
        """Return what is waited for, or why it does not come."""
        if self.found is None:
            return Reason(f"connecting to {self.address}")
        attempts = self._attempts - self._attempts_before
        often = f", refused {attempts} times" if self.found is NOBODY and attempts > 1 else ""
        text = self.found.at_address.replace("{}", self.address, 1)
        return Reason(f"{text}{often}", self.found.further)

    def close(self) -> None:
        """Withdraw the probe."""
        if self._probe is not None:
            self._probe.close()
            self._probe = None

    def _read(self, probe: ConnectionRequest, now_ns: int) -> None:
        error, is_late = probe.result(), now_ns - probe.asked_ns >= SILENT_NS
        if error == 0:
            answer, is_over = probe.answer()
            if not (is_late or is_over or self._is_whole(answer)):
                return
            self.found = self._judge(answer, is_over)
        elif error is None:
            if not is_late:
                return
            self.found = SILENT
        elif error in _NO_ROUTE:
            self.found = UNROUTED
        elif error in _REFUSED:
            self.found = NOBODY
        else:
            words = os.strerror(error)
            self.found = Finding(f"cannot connect to {{}}: {words}", f"is not reached: {words}")
        self.close()

    @staticmethod
    def _is_whole(answer: bytes) -> bool:
        """Return whether an answer shows what the program is."""
        return b"\n" in answer if answer[:1] != b"\xff" else _KIND.search(answer) is not None

    def _judge(self, answer: bytes, broke_off: bool) -> Finding | None:
        """Return what an answer to the greeting shows; None for one of a node."""
        if not answer:
            return BREAKS_OFF if broke_off else MUTE
        if _ZEROMQ.match(answer) is None:
            sent = f"it sends {quoted(answer.splitlines()[0])}"
            whole = f"{{}} answers, but is no node: {sent}"
            return Finding(whole, f"is no node's: {sent}", "check the address", is_program=True)
        kind = _KIND.search(answer)
        if kind is not None:
            return None if kind[1].decode() in self._kinds else NO_DATA
        self._greeted += 1
        return NO_DATA if self._greeted > 1 and self._kinds == DATA_KINDS else None
