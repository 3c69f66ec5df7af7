"""Eclipse Zenoh: two peers on a TCP connection, without batching."""

import json
import time
from collections.abc import Iterable, Iterator

from benchmarks.peers.message import FIELDS, VALUE, Arrival, Wire

KEY = "telepulse/force"


def publish(wire: Wire, numbers: Iterable[int]) -> None:
    """Send a message for each number."""
    import zenoh

    session = zenoh.open(zenoh.Config.from_json5(_config("listen", wire)))
    force = session.declare_publisher(KEY, express=True)
    for sequence in numbers:
        force.put(FIELDS.pack(sequence, time.perf_counter_ns(), VALUE))


def subscribe(wire: Wire) -> Iterator[Arrival]:
    """Yield messages as they arrive."""
    import zenoh

    # Both end with their last reference.
    session = zenoh.open(zenoh.Config.from_json5(_config("connect", wire)))
    force = session.declare_subscriber(KEY)
    for sample in force:
        sequence, sent_ns, _ = FIELDS.unpack(sample.payload.to_bytes())
        yield Arrival(sequence, sent_ns, time.perf_counter_ns())


def _config(side: str, wire: Wire) -> str:
    return json.dumps(
        {
            "mode": "peer",
            side: {"endpoints": [f"tcp/127.0.0.1:{wire.port}"]},
            "scouting": {"multicast": {"enabled": False}},
        }
    )
