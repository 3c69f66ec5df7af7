"""Lab Streaming Layer: an outlet that sends each sample at once, an inlet that blocks for it."""

import time
from collections.abc import Iterable, Iterator

from benchmarks.peers.message import Arrival, Wire

RATE_HZ = 1_000
RESOLVE_S = 20.0
# Finds streams of this machine only, and none of other programs.
CONFIG = """
[ports]
IPv6 = disable
[multicast]
ResolveScope = machine
[lab]
KnownPeers = {{127.0.0.1}}
SessionID = telepulse-{port}
[log]
level = -2
"""


def publish(wire: Wire, numbers: Iterable[int]) -> None:
    """Send a sample for each number; its channels are the number and the time."""
    _configure(wire)
    import pylsl

    # Doubles hold nanoseconds exactly for the first 104 days of a machine.
    info = pylsl.StreamInfo("pulse", "force", 2, RATE_HZ, pylsl.cf_double64, f"{wire.port}")
    outlet = pylsl.StreamOutlet(info, chunk_size=1)
    for sequence in numbers:
        outlet.push_sample((sequence, time.perf_counter_ns()))


def subscribe(wire: Wire) -> Iterator[Arrival]:
    """Yield messages as they arrive."""
    _configure(wire)
    import pylsl

    found = pylsl.resolve_byprop("source_id", f"{wire.port}", timeout=RESOLVE_S)
    inlet = pylsl.StreamInlet(found[0], processing_flags=0)
    while True:
        (sequence, sent_ns), _ = inlet.pull_sample()
        yield Arrival(int(sequence), int(sent_ns), time.perf_counter_ns())


def _configure(wire: Wire) -> None:
    import pylsl

    pylsl.set_config_content(CONFIG.format(port=wire.port))
