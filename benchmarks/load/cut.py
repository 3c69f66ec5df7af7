"""Time until a relay has frames again once the link to its sensing node is back."""

import time
from contextlib import ExitStack

import zmq

from benchmarks.benchmark import Benchmark
from benchmarks.load.run import process, relay
from benchmarks.load.sensing import Stream, sense
from protocol import sockets
from protocol.wire.messages import ClockRequest, encode_control
from telepulse.processes import free_addresses
from telepulse.simulation.link_scene import parse_link
from tests.support.netem import emulate, unavailable

LINK, CUT = "delay=5ms", "loss=100%"
CUTS_S = (1.0, 3.0, 5.0, 8.0)
ASK_EVERY_S = 0.05
SETTLED_S = 3.0
PATIENCE_S = 60.0


def main(benchmark: Benchmark) -> None:
    """Print the table, where the link emulator runs."""
    reason = unavailable()
    if reason is not None:
        print(f"cuts before a relay: left out: {reason}")
        return
    with ExitStack() as stack:
        link = stack.enter_context(emulate(parse_link(LINK)))
        address, bound = f"tcp://{link.sensing.address}:5555", free_addresses(1)[0]
        with link.sensing.entered():
            stack.enter_context(process(sense, Stream(batch=5), address))
        with link.display.entered():
            stack.enter_context(process(relay, address, bound))
            context: sockets.Context = stack.enter_context(zmq.Context())
            display = Display(context, bound)
            stack.callback(display.close)
        display.await_frame()
        rows, back_s = [], list[float]()
        for cut_s in CUTS_S:
            display.live(SETTLED_S)
            link.change(parse_link(CUT), link_index=0)
            display.live(cut_s)
            link.change(parse_link(LINK), link_index=0)
            back_s.append(display.await_frame())
            rows.append((f"{cut_s:g}", f"{back_s[-1]:.2f}"))
    benchmark.table("A relay's link, cut", ("for s", "frames again after s"), rows)
    benchmark.judge("time until a relay has frames again after a cut", max(back_s))


class Display:
    """A display that receives frames and requests the clock."""

    def __init__(self, context: sockets.Context, address: str) -> None:
        self._data = sockets.connect(context, zmq.SUB, address)
        self._data.subscribe(b"")
        self._control = sockets.connect(context, zmq.DEALER, sockets.control_address(address))

    def live(self, seconds: float) -> None:
        """Receive and request for `seconds`."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._ask()
            time.sleep(ASK_EVERY_S)
            for _ in sockets.receive_parts(self._data):
                pass

    def await_frame(self) -> float:
        """Return the time in s until a frame arrives. Raises TimeoutError."""
        began_s = time.monotonic()
        while not self._data.poll(round(ASK_EVERY_S * 1000)):
            if time.monotonic() - began_s > PATIENCE_S:
                raise TimeoutError("no frame comes through the relay")
            self._ask()
        return time.monotonic() - began_s

    def close(self) -> None:
        """Close the sockets."""
        self._data.close(0)
        self._control.close(0)

    def _ask(self) -> None:
        for _ in sockets.receive_parts(self._control):
            pass
        sockets.send(self._control, encode_control(ClockRequest(time.perf_counter_ns())))
