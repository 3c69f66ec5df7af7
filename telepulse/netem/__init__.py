"""Emulated links for real programs: kernel TCP between two network namespaces, impaired between.

Needs root and /dev/net/tun. Namespaces and devices vanish with the process that made them.
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
