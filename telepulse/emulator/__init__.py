"""A link for real programs: real kernel TCP between two network namespaces, made worse on the way.

Needs root and /dev/net/tun; everything it makes vanishes with the process that made it.
"""

from telepulse.emulator.emulated_link import EmulatedLink, emulate
from telepulse.emulator.namespace import EmulatorError, Namespace, unavailable
from telepulse.emulator.nodes import Outcome, run_nodes
from telepulse.emulator.packet_filter import PacketFilter

__all__ = [
    "EmulatedLink",
    "EmulatorError",
    "Namespace",
    "Outcome",
    "PacketFilter",
    "emulate",
    "run_nodes",
    "unavailable",
]
