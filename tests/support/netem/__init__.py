"""Emulated links for real programs: kernel TCP between two network namespaces, with impairments.

They need root and /dev/net/tun. Namespaces and devices end with the process that made them.
"""

from tests.support.netem.emulated_link import EmulatedLink, emulate
from tests.support.netem.forwarder import PacketFilter
from tests.support.netem.namespace import EmulatorError, Namespace, unavailable

__all__ = ["EmulatedLink", "EmulatorError", "Namespace", "PacketFilter", "emulate"]
__all__ += ["unavailable"]
