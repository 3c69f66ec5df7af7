"""Displays on one side, a sensing node or a further relay on the other."""

import time
from collections.abc import Callable

import zmq

from display_node.connection import ANSWER_NS, CUT_NS, PATIENCE_NS, Lookup
from protocol import sockets
from protocol.gate import Gate
from protocol.keys import ClientKeys, ServerKeys
from protocol.refusals import Refusals
from protocol.summary import Frames, Summary
from telepulse.relay.proxy import Proxy
from telepulse.relay.silence import Silence

LOOK_EVERY_NS = 100_000_000
# How soon Ctrl-C is heeded.
WAIT_NS = 50_000_000
# Frames may be long; where the link is dead, control is silent, too, and tells sooner.
DATA_PATIENCE_NS = 10_000_000_000


class Relay:
    """Passes one stream on, and what its displays and its sensing node tell one another.

    It reads none of it. A display's subscription asks the sensing node for the frames, once for
    all displays; a display too slow for them loses the newest, as on the sensing node itself.
    """

    def __init__(
        self,
        connect: str,
        bind: str,
        log: Callable[[str], None],
        client_keys: ClientKeys | None = None,
        server_keys: ServerKeys | None = None,
    ) -> None:
        """connect: where the sensing node is; bind: where displays connect. client_keys: towards
        the sensing node; server_keys: which displays are let in.

        Raises AddressError, KeyFileError.
        """
        sockets.control_address(connect)
        control = sockets.control_address(bind)
        self._connect = connect
        self._log = log
        self._stopping = False
        self._context: sockets.Context = zmq.Context()
        context = self._context
        self._gate = None if server_keys is None else Gate(context, server_keys, log)
        self._refusals = Refusals(context, client_keys, log)
        data_in = sockets.unconnected(context, zmq.XSUB, client_keys)
        control_in = sockets.unconnected(context, zmq.DEALER, client_keys)
        self._refusals.watch(data_in)
        self._refusals.watch(control_in)
        self._data = Proxy(context, sockets.bind(context, zmq.XPUB, bind, self._gate), data_in)
        control_out = sockets.bind(context, zmq.ROUTER, control, self._gate)
        self._control = Proxy(context, control_out, control_in)
        self._silences = (
            Silence(CUT_NS, once_heard=True),
            Silence(PATIENCE_NS),
            Silence(DATA_PATIENCE_NS),
        )
        self._lookup = Lookup(connect, log)
        self._address: str | None = None
        self._next_look_ns = 0
        self.reconnections = 0

    def stop(self) -> None:
        """End in a moment."""
        self._stopping = True

    def run(self, seconds: float | None = None) -> Summary:
        """Pass messages on until stopped, or `seconds` are over."""
        end_ns = None if seconds is None else time.monotonic_ns() + round(seconds * 1e9)
        self._lookup.start()
        try:
            self._start()
            while not self._stopping:
                now_ns = time.monotonic_ns()
                if end_ns is not None and now_ns >= end_ns:
                    break
                self._tend(now_ns)
                sockets.wait_readable(() if self._gate is None else self._gate.sockets, WAIT_NS)
        finally:
            self._stop()
            self._context.destroy(linger=sockets.LINGER_MS)
        return self._summary()

    def _start(self) -> None:
        self._data.start()
        self._control.start()

    def _stop(self) -> None:
        self._data.stop()
        self._control.stop()

    def _tend(self, now_ns: int) -> None:
        """Connect once the sensing node's address is known, and anew where nothing is heard."""
        self._refusals.tend(now_ns)
        if self._gate is not None:
            self._gate.tend(now_ns)
        found = self._lookup.take()
        if found is not None:
            self._reconnect(found)
        if now_ns < self._next_look_ns:
            return
        self._next_look_ns = now_ns + LOOK_EVERY_NS
        self._data.look()
        self._control.look()
        if self._silent(now_ns) and not self._lookup.running:
            self._lookup.start()

    def _silent(self, now_ns: int) -> bool:
        # A display that asks for the clock wants frames as well.
        asked, answers, frames = self._control.asked, self._control.heard, self._data.heard
        lasts = [
            silence.lasts(now_ns, asked, heard)
            for silence, heard in zip(
                self._silences, (answers + frames, answers, frames), strict=True
            )
        ]
        return self._address is None or any(lasts)

    def _reconnect(self, address: str) -> None:
        """Connect to `address`; what still waits for the old connection is given up with it."""
        if self._address is not None:
            self.reconnections += 1
            if self.reconnections == 1:
                self._log(f"{self._connect} is silent; connecting anew, as often as it is")
        # The kernel repeats a request to connect after 1 s, which is late where a cut has ended
        # meanwhile; but a way may take longer than one hurries.
        answer_ns = ANSWER_NS if self.reconnections % 2 else 0
        self._stop()
        was, control = self._address, sockets.control_address
        sockets.reconnect(self._data.sensing, was, address, answer_ns)
        sockets.reconnect(self._control.sensing, was and control(was), control(address), answer_ns)
        self._address = address
        for silence in self._silences:
            silence.begin_anew()
        self._start()

    def _summary(self) -> Summary:
        self._log(
            f"{self._data.heard} frames ({_megabytes(self._data)}) and {_megabytes(self._control)}"
            f" of answers came from {self._connect}, over {1 + self.reconnections} connections;"
            f" {self._control.dropped} questions found no room"
        )
        rejected = self._refusals.rejected
        if self._gate is not None:
            rejected = rejected + self._gate.rejected
        return Summary(frames=Frames(received=self._data.heard), rejected=dict(rejected))


def _megabytes(proxy: Proxy) -> str:
    return f"{proxy.heard_bytes * 1e-6:.1f} MB"
