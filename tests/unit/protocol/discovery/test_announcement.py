"""Encoding, decoding and selection of announcements, also of arbitrary bytes."""

from ipaddress import ip_interface

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.discovery.announcement import (
    MAX_LABEL_BYTES,
    MAX_STRING_BYTES,
    SERVICE,
    Announcement,
    announced_addresses,
    fingerprint,
    matching,
    only_match,
    reachable,
    read_announcement,
    to_txt,
)
from protocol.errors import DiscoveryError, WireError

KEY = bytes(range(32))
ADDRESS = bytes([192, 0, 2, 7])


def wire(node: Announcement) -> dict[bytes, bytes | None]:
    return {key.encode(): word.encode() for key, word in to_txt(node).items()}


names = st.text(st.characters(categories=["L", "N", "P", "Zs"]), min_size=1, max_size=80)


@given(stream=names.filter(str.isprintable), host=st.from_regex(r"[a-z0-9-]{1,60}", fullmatch=True))
def test_an_announcement_is_decoded_as_it_was_encoded(stream: str, host: str) -> None:
    node = Announcement.of_node(stream, host, 5555, KEY)
    assert len(node.name.encode()) <= MAX_LABEL_BYTES
    assert all(len(f"{k}={w}".encode()) <= MAX_STRING_BYTES for k, w in to_txt(node).items())
    read = read_announcement(f"{node.name}.{SERVICE}", [ADDRESS], 5555, wire(node))
    assert read.addresses == ("192.0.2.7",)
    assert (read.name, read.node, read.port) == (node.name, node.node, 5555)
    assert stream.startswith(read.stream)
    assert read.fingerprint == fingerprint(KEY)


GOOD = Announcement.of_node("radial pulse", "ward-3", 5555, KEY)


@pytest.mark.parametrize(
    ("changes", "cause", "reason"),
    [
        ({b"v": b"1"}, "version", "the peer has version 1 of the protocol"),
        ({b"v": None}, "version", "the peer has version none"),
        ({b"control": b"5557"}, "malformed", "ports"),
        ({b"control": b"x"}, "malformed", "ports"),
        ({b"stream": b""}, "malformed", "no name"),
        ({b"stream": b"a" * 81}, "malformed", "no name"),
        ({b"stream": b"\x1b[2J"}, "malformed", "no text"),
        ({b"stream": b"\xff\xfe"}, "malformed", "no text"),
        ({b"id": b"12"}, "malformed", "id"),
        ({b"key": b""}, "malformed", "key"),
        ({b"key": b"g" * 32}, "malformed", "key"),
    ],
)
def test_an_invalid_record_is_refused(
    changes: dict[bytes, bytes | None], cause: str, reason: str
) -> None:
    with pytest.raises(WireError, match=reason) as refused:
        read_announcement(f"{GOOD.name}.{SERVICE}", [ADDRESS], 5555, wire(GOOD) | changes)
    assert refused.value.cause == cause


@pytest.mark.parametrize(
    ("instance", "addresses", "port"),
    [
        ("a.b._http._tcp.local.", [ADDRESS], 5555),
        (SERVICE, [ADDRESS], 5555),
        (f"\x07.{SERVICE}", [ADDRESS], 5555),
        (f"a.{SERVICE}", [], 5555),
        (f"a.{SERVICE}", [bytes(16)], 5555),
        (f"a.{SERVICE}", [bytes([224, 0, 0, 1]), bytes(4)], 5555),
        (f"a.{SERVICE}", [ADDRESS] * 17, 5555),
        (f"a.{SERVICE}", [ADDRESS], None),
        (f"a.{SERVICE}", [ADDRESS], 0),
        (f"a.{SERVICE}", [ADDRESS], 65_535),
    ],
)
def test_an_invalid_service_is_refused(
    instance: str, addresses: list[bytes], port: int | None
) -> None:
    with pytest.raises(WireError):
        read_announcement(instance, addresses, port, wire(GOOD))


keys = st.sampled_from([b"v", b"id", b"stream", b"control", b"key"]) | st.binary(max_size=9)
words = st.none() | st.binary(max_size=300) | st.sampled_from(list(wire(GOOD).values()))


@given(
    instance=st.text(max_size=90) | st.text(max_size=70).map(f"{{}}.{SERVICE}".format),
    addresses=st.lists(st.binary(max_size=20), max_size=20),
    port=st.none() | st.integers(-1, 70_000),
    txt=st.dictionaries(keys, words, max_size=12).map(lambda some: wire(GOOD) | some),
)
def test_any_announcement_is_read_or_refused_in_one_line(
    instance: str, addresses: list[bytes], port: int | None, txt: dict[bytes, bytes | None]
) -> None:
    try:
        read = read_announcement(instance, addresses, port, txt)
    except WireError as error:
        assert error.cause in ("malformed", "version")  # noqa: PT017
        assert str(error).isprintable()  # noqa: PT017
        return
    assert read.name.isprintable()
    assert read.stream.isprintable()
    assert 0 < len(read.addresses) <= 16


OWN = [
    ip_interface(one)
    for one in ("127.0.0.1/8", "192.0.2.2/24", "172.17.0.1/16", "::1/128", "2001:db8::2/64")
]


@pytest.mark.parametrize(
    ("addresses", "used"),
    [
        (("192.0.2.7",), ["192.0.2.7"]),
        # Two networks, one of which is this machine's; an address that both machines have.
        (("192.0.2.7", "198.51.100.7"), ["192.0.2.7"]),
        (("192.0.2.7", "172.17.0.1"), ["192.0.2.7"]),
        # Two networks that are both this machine's.
        (("192.0.2.7", "172.17.0.9"), ["192.0.2.7", "172.17.0.9"]),
        # This machine.
        (("192.0.2.2", "172.17.0.1"), ["192.0.2.2"]),
        (("127.0.0.1",), ["127.0.0.1"]),
        # The same network by both versions of IP, and by the newer one alone.
        (("192.0.2.7", "2001:db8::7"), ["192.0.2.7"]),
        (("203.0.113.9", "2001:db8::7"), ["2001:db8::7"]),
        # An address on another network.
        (("203.0.113.9",), []),
    ],
)
def test_only_addresses_on_own_networks_are_used(
    addresses: tuple[str, ...], used: list[str]
) -> None:
    node = Announcement("a", "pulse", "0" * 16, addresses, 5555, None)
    assert reachable(node, OWN) == used


def test_the_addresses_that_are_bound_are_announced() -> None:
    assert announced_addresses("*", OWN) == ["192.0.2.2", "172.17.0.1"]
    assert announced_addresses("127.0.0.1", OWN) == ["127.0.0.1"]
    everywhere = ["192.0.2.2", "172.17.0.1", "2001:db8::2"]
    assert announced_addresses("[::]", OWN) == everywhere
    assert announced_addresses("[2001:db8::2]", OWN) == ["2001:db8::2"]
    with pytest.raises(DiscoveryError, match=r"192\.0\.2\.9: is no address here"):
        announced_addresses("192.0.2.9", OWN)
    with pytest.raises(DiscoveryError, match="on no network"):
        announced_addresses("*", OWN[:1])


def test_a_node_is_selected_by_its_name_and_by_its_key() -> None:
    left, right = (Announcement.of_node("pulse", host, 5555, KEY) for host in ("left", "right"))
    spoofed = Announcement.of_node("pulse", "other", 5555, None)
    found = [right, left, spoofed]
    assert matching(found, None, None) == found
    assert matching(found, None, fingerprint(KEY)) == [right, left]
    assert only_match(matching(found, "Pulse on LEFT", None)) == left
    with pytest.raises(DiscoveryError, match=r"2 .*'pulse on left', 'pulse on right'; .*--named"):
        only_match(matching(found, None, fingerprint(KEY)))
    with pytest.raises(DiscoveryError, match="just gone"):
        only_match([])
