"""The display node's shell: sockets, the clock on the wall, and one real-time loop."""

import time
import uuid

import zmq

from display_node.display import Display
from display_node.scene import DisplayScene
from display_node.telemetry import STATUS, STATUS_TRACES, TRACE, TraceWriter, write_status
from protocol import sockets
from protocol.histogram import Histogram
from protocol.messages import encode_control
from protocol.summary import Summary, TickTime

RECONNECT_EVERY_NS = 2_000_000_000


class DisplayNode:
    """A display on real sockets. One thread: poll until the next tick, ingest, tick."""

    def __init__(self, scene: DisplayScene, address: str, telemetry_address: str) -> None:
        """Raises AddressError when an address cannot be used."""
        self._scene = scene
        self._stopping = False
        self._misses = 0
        self._tick_us = Histogram(1.0, 5_000)
        self._trace = TraceWriter()
        self._traces = 0
        self._subscribed = False
        self._context: sockets.Context = zmq.Context()
        self._address, self._control_address = address, sockets.control_address(address)
        self._control = sockets.connect(self._context, zmq.DEALER, self._control_address)
        self._data = [sockets.connect(self._context, zmq.SUB, address) for _ in range(scene.paths)]
        self._next_reconnect_ns = time.monotonic_ns() + RECONNECT_EVERY_NS
        self._telemetry = sockets.bind(self._context, zmq.PUB, telemetry_address)
        self.telemetry_address = self._telemetry.getsockopt_string(zmq.LAST_ENDPOINT)
        self._display = Display(scene, name=f"display-{uuid.uuid4().hex[:6]}")

    def stop(self) -> None:
        """End the loop after the present tick."""
        self._stopping = True

    def run(self, seconds: float | None = None, once: bool = False) -> Summary:
        """Run the loop until stopped, `seconds` are over, or (once) the stream has ended."""
        tick_ns = self._scene.tick_ns
        readable = [self._control, *self._data]
        start_ns = time.monotonic_ns()
        end_ns = None if seconds is None else start_ns + round(seconds * 1e9)
        next_ns = start_ns + tick_ns
        try:
            while not self._stopping:
                self._receive()
                now_ns = time.monotonic_ns()
                if now_ns < next_ns:
                    sockets.wait_readable(readable, next_ns - now_ns)
                    continue
                elapsed = 1 + (now_ns - next_ns) // tick_ns
                self._misses += elapsed - 1
                next_ns += elapsed * tick_ns
                self._tick(now_ns, elapsed)
                self._tick_us.add((time.monotonic_ns() - now_ns) * 1e-3)
                if (end_ns is not None and now_ns >= end_ns) or (once and self._display.over):
                    break
            return self._finish()
        finally:
            self._context.destroy(linger=sockets.LINGER_MS)

    def _receive(self) -> None:
        display = self._display
        for parts in sockets.receive_all(self._control):
            display.on_control(b"".join(parts), time.monotonic_ns())
        if not self._subscribed and display.receiver.listening:
            self._subscribed = True
            for socket in self._data:
                socket.subscribe(b"")
        for socket in self._data:
            for parts in sockets.receive_all(socket):
                display.on_frame(b"".join(parts), time.monotonic_ns())

    def _tick(self, now_ns: int, elapsed_ticks: int) -> None:
        felt = self._display.tick(now_ns, elapsed_ticks)
        for message in self._display.requests(now_ns):
            sockets.send(self._control, encode_control(message))
        if now_ns >= self._next_reconnect_ns:
            self._next_reconnect_ns = now_ns + RECONNECT_EVERY_NS
            if self._display.receiver.silent(now_ns):
                self._reconnect()
        trace = self._trace.add(felt)
        if trace is not None:
            sockets.send(self._telemetry, TRACE, trace)
            self._traces += 1
            if self._traces % STATUS_TRACES == 0:
                self._send_status(final=False)

    def _reconnect(self) -> None:
        sockets.reconnect(self._control, self._control_address)
        for socket in self._data:
            sockets.reconnect(socket, self._address)

    def _summary(self) -> Summary:
        times = TickTime(self._tick_us.quantile(0.5), self._tick_us.quantile(0.99))
        return self._display.summary(self._misses, times)

    def _send_status(self, final: bool) -> None:
        sockets.send(self._telemetry, STATUS, write_status(self._display, self._summary(), final))

    def _finish(self) -> Summary:
        if self._display.fidelity is not None:
            self._display.fidelity.finish()
        self._send_status(final=True)
        return self._summary()
