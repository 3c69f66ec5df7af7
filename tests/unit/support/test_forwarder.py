import struct

import pytest

from tests.support.netem.forwarder import PacketFilter

SYN, ACK = 0x02, 0x10
DATA, CONTROL, DISPLAY = 5555, 5556, 40_000


def packet(source: int, destination: int, flags: int = ACK, protocol: int = 6) -> bytes:
    ip = struct.pack("!BBHHHBBH8x", 0x45, 0, 40, 0, 0, 64, protocol, 0)
    return ip + struct.pack("!HHIIBBHHH", source, destination, 0, 0, 0x50, flags, 0, 0, 0)


@pytest.mark.parametrize(
    ("rule", "there", "back", "control", "syn"),
    [
        (PacketFilter(), True, True, True, True),
        (PacketFilter(port=DATA), True, True, False, True),
        (PacketFilter(towards="display"), True, False, True, False),
        (PacketFilter(towards="sensing"), False, True, False, True),
        (PacketFilter(syn_only=True), False, False, False, True),
    ],
)
def test_a_filter_drops_by_port_direction_and_kind(
    rule: PacketFilter, there: bool, back: bool, control: bool, syn: bool
) -> None:
    assert rule.drops(packet(DATA, DISPLAY), "display") is there
    assert rule.drops(packet(DISPLAY, DATA), "sensing") is back
    assert rule.drops(packet(CONTROL, DISPLAY), "display") is control
    assert rule.drops(packet(DISPLAY, DATA, SYN), "sensing") is syn


def test_other_packets_than_tcp_pass() -> None:
    assert not PacketFilter().drops(packet(DATA, DISPLAY, protocol=17), "display")
    assert not PacketFilter().drops(packet(DATA, DISPLAY)[:30], "display")
