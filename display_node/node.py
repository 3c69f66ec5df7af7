"""The display node's shell: sockets, the clock on the wall, and one real-time loop."""

import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import replace

import zmq

from display_node.connection import Connection
from display_node.display import Display
from display_node.hardware import Hardware
from display_node.scene import DisplayScene
from display_node.telemetry import STATUS, STATUS_TRACES, TRACE, TraceWriter, write_status
from protocol import sockets
from protocol.histogram import Histogram
from protocol.messages import encode_control
from protocol.summary import Summary, TickTime


class DisplayNode:
    """A display on real sockets. One thread: poll until the next tick, ingest, tick."""

    def __init__(
        self,
        scene: DisplayScene,
        addresses: Sequence[str],
        telemetry_address: str,
        log: Callable[[str], None],
        hardware: Hardware | None = None,
    ) -> None:
        """addresses: of the one sensing node, each over a network of its own. hardware: the real
        bench, started, in place of the scene's models.

        Raises AddressError when an address cannot be used.
        """
        paths = max(scene.paths, len(addresses))
        self._scene = scene = scene.model_copy(update={"paths": paths})
        self._stopping = False
        self._misses = 0
        self._tick_us = Histogram(1.0, 5_000)
        self._trace = TraceWriter()
        self._traces = 0
        self._context: sockets.Context = zmq.Context()
        self._connection = Connection(self._context, addresses, paths, log)
        self._telemetry = sockets.bind(self._context, zmq.PUB, telemetry_address)
        self.telemetry_address = self._telemetry.getsockopt_string(zmq.LAST_ENDPOINT)
        self._hardware = hardware
        self._display = Display(
            scene,
            name=f"display-{uuid.uuid4().hex[:6]}",
            feedback=None if hardware is None else hardware.feedback,
        )

    def stop(self) -> None:
        """End the loop after the present tick."""
        self._stopping = True

    def run(self, seconds: float | None = None, once: bool = False) -> Summary:
        """Run the loop until stopped, `seconds` are over, or (once) the stream has ended."""
        tick_ns = self._scene.tick_ns
        start_ns = time.monotonic_ns()
        end_ns = None if seconds is None else start_ns + round(seconds * 1e9)
        next_ns = start_ns + tick_ns
        try:
            while not self._stopping:
                self._receive()
                now_ns = time.monotonic_ns()
                if now_ns < next_ns:
                    sockets.wait_drained(self._connection.descriptors, next_ns - now_ns)
                    continue
                elapsed = 1 + (now_ns - next_ns) // tick_ns
                self._misses += elapsed - 1
                next_ns += elapsed * tick_ns
                # As of when it was due: told so, speeds add up to the way, however late each is.
                self._tick(next_ns - tick_ns, elapsed)
                self._tick_us.add((time.monotonic_ns() - now_ns) * 1e-3)
                if (end_ns is not None and now_ns >= end_ns) or (once and self._display.over):
                    break
            return self._finish()
        finally:
            self._context.destroy(linger=sockets.LINGER_MS)

    def _receive(self) -> None:
        display, connection = self._display, self._connection
        receiver = display.receiver
        for route in connection.routes:
            before, _ = receiver.frames
            for message in route.data.messages():
                display.on_frame(message, time.monotonic_ns())
            route.won += receiver.frames[0] - before
        for message in connection.control.messages():
            display.on_control(message, time.monotonic_ns())
        if receiver.listening and receiver.description is not None:
            connection.subscribe(receiver.description.batch * receiver.description.period_ns)

    def _tick(self, now_ns: int, elapsed_ticks: int) -> None:
        if self._hardware is None:
            felt = self._display.tick(now_ns, elapsed_ticks)
        else:
            felt = self._hardware.tick(self._display, now_ns, elapsed_ticks)
        if self._connection.tend(now_ns):
            self._display.receiver.introduce()
        (control,) = self._connection.control.sockets
        for message in self._display.requests(time.monotonic_ns()):
            sockets.send(control, encode_control(message))
        trace = self._trace.add(felt)
        if trace is not None:
            sockets.send(self._telemetry, TRACE, trace)
            self._traces += 1
            if self._traces % STATUS_TRACES == 0:
                self._send_status(final=False)

    def _summary(self) -> Summary:
        times = TickTime(self._tick_us.quantile(0.5), self._tick_us.quantile(0.99))
        summary, routes = self._display.summary(self._misses, times), self._connection.routes
        if self._hardware is not None:
            summary = replace(
                summary,
                hardware=dict(self._hardware.counts),
                faults=[*summary.faults, *self._hardware.faults()],
            )
        if len(routes) == 1:
            return summary
        first = {route.address: route.won for route in routes}
        return replace(summary, frames=replace(summary.frames, first=first))

    def _send_status(self, final: bool) -> None:
        sockets.send(self._telemetry, STATUS, write_status(self._display, self._summary(), final))

    def _finish(self) -> Summary:
        if self._hardware is not None:
            self._hardware.withdraw()
        if self._display.fidelity is not None:
            self._display.fidelity.finish()
        self._send_status(final=True)
        return self._summary()
