"""A link for real programs: real kernel TCP between two network namespaces, made worse on the way.

Needs root and /dev/net/tun; everything it makes vanishes with the process that made it.
"""

from telepulse.netem.emulated_link import EmulatedLink, emulate
from telepulse.netem.forwarder import PacketFilter
from telepulse.netem.namespace import EmulatorError, Namespace, unavailable
from telepulse.netem.nodes import NodesOutcome, run_nodes

__all__ = [
    "EmulatedLink",
    "EmulatorError",
    "Namespace",
    "NodesOutcome",
    "PacketFilter",
    "emulate",
    "run_nodes",
    "unavailable",
]
