"""The alternatives: pyzmq with msgpack, Lab Streaming Layer, and Eclipse Zenoh.

Each has a publisher, which sends a message for each number, and a subscriber, which yields messages
as they arrive. LSL and Zenoh are imported where they are used: they may not be installed.
"""

import json
import time
from collections.abc import Iterable, Iterator
from typing import Any

import msgpack
import zmq

from benchmarks.peers.message import FIELDS, VALUE, Arrival, Wire, join, serve
from protocol.sockets import Context

LSL_CONFIG = """
[ports]
IPv6 = disable
[multicast]
ResolveScope = machine
[lab]
KnownPeers = {{{peer}}}
SessionID = telepulse-{session}
[log]
level = -2
"""
RATE_HZ = 1_000
RESOLVE_S = 20.0
ZENOH_KEY = "telepulse/force"


def publish_pyzmq(wire: Wire, numbers: Iterable[int]) -> None:
    """Send by PUB."""
    context: Context = zmq.Context()
    socket = serve(context.socket(zmq.PUB), wire.keys)
    socket.bind(f"tcp://127.0.0.1:{wire.port}")
    pack = msgpack.Packer().pack
    for sequence in numbers:
        socket.send(pack((sequence, time.perf_counter_ns(), VALUE)))


def subscribe_pyzmq(wire: Wire) -> Iterator[Arrival]:
    """Receive by SUB, one blocking receive for each message."""
    context: Context = zmq.Context()
    socket = join(context.socket(zmq.SUB), wire.keys)
    socket.subscribe(b"")
    socket.connect(f"tcp://127.0.0.1:{wire.port}")
    while True:
        sequence, sent_ns, _ = msgpack.unpackb(socket.recv())
        yield Arrival(sequence, sent_ns, time.perf_counter_ns())


def publish_lsl(wire: Wire, numbers: Iterable[int]) -> None:
    """Send each sample at once; its channels are the number and the time."""
    pylsl = load_lsl("127.0.0.1", str(wire.port))
    # Doubles hold nanoseconds exactly for the first 104 days of a machine.
    info = pylsl.StreamInfo("pulse", "force", 2, RATE_HZ, pylsl.cf_double64, f"{wire.port}")
    outlet = pylsl.StreamOutlet(info, chunk_size=1)
    for sequence in numbers:
        outlet.push_sample((sequence, time.perf_counter_ns()))


def subscribe_lsl(wire: Wire) -> Iterator[Arrival]:
    """Receive by an inlet that blocks for each sample."""
    pylsl = load_lsl("127.0.0.1", str(wire.port))
    found = pylsl.resolve_byprop("source_id", f"{wire.port}", timeout=RESOLVE_S)
    inlet = pylsl.StreamInlet(found[0], processing_flags=0)
    while True:
        (sequence, sent_ns), _ = inlet.pull_sample()
        yield Arrival(int(sequence), int(sent_ns), time.perf_counter_ns())


def load_lsl(peer: str, session: str) -> Any:
    """Return pylsl, which finds streams at a peer's address only, and none of other programs."""
    import pylsl

    pylsl.set_config_content(LSL_CONFIG.format(peer=peer, session=session))
    return pylsl


def publish_zenoh(wire: Wire, numbers: Iterable[int]) -> None:
    """Send over TCP, without batching."""
    import zenoh

    session = zenoh.open(zenoh.Config.from_json5(_zenoh_config("listen", wire)))
    force = session.declare_publisher(ZENOH_KEY, express=True)
    for sequence in numbers:
        force.put(FIELDS.pack(sequence, time.perf_counter_ns(), VALUE))


def subscribe_zenoh(wire: Wire) -> Iterator[Arrival]:
    """Receive over TCP."""
    import zenoh

    # Both end with their last reference.
    session = zenoh.open(zenoh.Config.from_json5(_zenoh_config("connect", wire)))
    force = session.declare_subscriber(ZENOH_KEY)
    for sample in force:
        sequence, sent_ns, _ = FIELDS.unpack(sample.payload.to_bytes())
        yield Arrival(sequence, sent_ns, time.perf_counter_ns())


def _zenoh_config(side: str, wire: Wire) -> str:
    return json.dumps(
        {
            "mode": "peer",
            side: {"endpoints": [f"tcp/127.0.0.1:{wire.port}"]},
            "scouting": {"multicast": {"enabled": False}},
        }
    )
