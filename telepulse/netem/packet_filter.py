"""Packets that an emulated link drops by their TCP header, as a firewall would."""

import json
import struct
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Literal

TCP = 6
SYN = 0x02


@dataclass(frozen=True, slots=True)
class PacketFilter:
    """A rule that drops TCP packets of one link.

    port: the sensing node's; None: any. towards: the node that does not receive them, None: both.
    syn_only: requests to connect and their answers alone; established connections go on.
    """

    port: int | None = None
    towards: Literal["sensing", "display"] | None = None
    syn_only: bool = False

    def drops(self, packet: bytes, towards: str) -> bool:
        """Return whether an IPv4 packet on its way towards a node is dropped."""
        if self.towards not in (None, towards):
            return False
        header = 4 * (packet[0] & 0x0F)
        if packet[9] != TCP or len(packet) < header + 14:
            return False
        source, destination = struct.unpack_from("!HH", packet, header)
        if self.port not in (None, destination if towards == "sensing" else source):
            return False
        return not self.syn_only or bool(packet[header + 13] & SYN)


def write_filters(filters: Iterable[PacketFilter]) -> str:
    """Return filters as one line of text."""
    return json.dumps([asdict(one) for one in filters])


def read_filters(text: str) -> tuple[PacketFilter, ...]:
    """Return the filters in a line that `write_filters` wrote."""
    return tuple(PacketFilter(**fields) for fields in json.loads(text))
