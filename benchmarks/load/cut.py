"""Time until a relay has frames again once the link to its sensing node is back."""

from contextlib import ExitStack

from benchmarks.benchmark import Benchmark
from benchmarks.load.many_displays import ManyDisplays
from benchmarks.load.run import relay
from benchmarks.load.sensing import Stream, sense
from benchmarks.timing import process
from telepulse.processes import free_addresses
from telepulse.simulation.link_scene import parse_link
from tests.support.netem import emulate, unavailable

LINK, CUT = "delay=5ms", "loss=100%"
CUTS_S = (1.0, 3.0, 5.0, 8.0)
CLOCK_MS = 50
SETTLED_S = 3.0


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
            display = ManyDisplays(bound, 1, CLOCK_MS)
            stack.callback(display.close)
        display.join()
        rows, back_s = [], list[float]()
        for cut_s in CUTS_S:
            display.live(round(SETTLED_S * 1e9))
            link.change(parse_link(CUT), link_index=0)
            display.live(round(cut_s * 1e9))
            link.change(parse_link(LINK), link_index=0)
            back_s.append(display.await_frame())
            rows.append((f"{cut_s:g}", f"{back_s[-1]:.2f}"))
    benchmark.table("A relay's link, cut", ("for s", "frames again after s"), rows)
    benchmark.judge("time until a relay has frames again after a cut", max(back_s))
