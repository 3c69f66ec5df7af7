"""Announcement of a sensing node as a DNS-SD service (RFC 6763): encoding, decoding, selection.

The service has an instance name, a port, its host's addresses and a TXT record. Anybody on the
network can read announcements and send them. Pure: no I/O.
"""

import hashlib
import ipaddress
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from ipaddress import IPv4Interface, IPv6Interface
from typing import Self

from protocol.config.quantities import MAX_NAME
from protocol.errors import DiscoveryError, VersionError, WireError
from protocol.wire.messages import VERSION

SERVICE = "_telepulse._tcp.local."
# Limits by RFC 6763 for an instance's name, and for a string in a TXT record.
MAX_LABEL_BYTES, MAX_STRING_BYTES = 63, 255
MAX_PORT = 65_534
MAX_ADDRESSES = 16
MAX_VERSION = 20
FINGERPRINT_BYTES, NODE_BYTES = 16, 8
# The second is bound for both versions of IP, the others for IPv4 alone.
EVERYWHERE = ("*", "[::]", "0.0.0.0")
Interface = IPv4Interface | IPv6Interface


@dataclass(frozen=True, slots=True)
class Announcement:
    """A sensing node as it is announced.

    name: instance name, unique on its network. stream: name of its stream. node: identity that
    stays the same after a restart, in hexadecimal digits. addresses: IP addresses of its host.
    port: of data; control is one higher. fingerprint: of its public key; None without keys.
    """

    name: str
    stream: str
    node: str
    addresses: tuple[str, ...]
    port: int
    fingerprint: str | None

    @classmethod
    def of_node(cls, stream: str, host: str, port: int, key: bytes | None) -> Self:
        """Return the announcement of a node with a public key, without its addresses."""
        known = None if key is None else fingerprint(key)
        ending = f" on {host}"
        name = _cut(stream, MAX_LABEL_BYTES - len(ending.encode())) + ending
        identity = f"{known or host}:{port}".encode()
        node = hashlib.blake2b(identity, digest_size=NODE_BYTES).hexdigest()
        stream = _cut(stream, MAX_STRING_BYTES - len("stream="))
        return cls(_cut(name, MAX_LABEL_BYTES), stream, node, (), port, known)


def fingerprint(key: bytes) -> str:
    """Return a public key's fingerprint: the beginning of its SHA-256 in hexadecimal digits."""
    return hashlib.sha256(key).hexdigest()[: 2 * FINGERPRINT_BYTES]


def to_txt(announcement: Announcement) -> dict[str, str]:
    """Return the TXT record of an announcement."""
    txt = {"v": str(VERSION), "id": announcement.node, "stream": announcement.stream}
    txt["control"] = str(announcement.port + 1)
    if announcement.fingerprint is not None:
        txt["key"] = announcement.fingerprint
    return txt


def read_announcement(
    instance: str, addresses: Sequence[bytes], port: int | None, txt: Mapping[bytes, bytes | None]
) -> Announcement:
    """Decode the announcement of an instance of the service.

    Raises WireError with the cause "version" for a node of another version, else "malformed".
    """
    name = instance.removesuffix("." + SERVICE)
    if name == instance or not name or not name.isprintable() or len(name) > MAX_LABEL_BYTES:
        raise WireError("malformed", "its name is not that of a node")
    version = _text(txt, b"v")
    if version != str(VERSION):
        raise VersionError(version[:MAX_VERSION] or "none", VERSION)
    if port is None or not 0 < port <= MAX_PORT or _text(txt, b"control") != str(port + 1):
        raise WireError("malformed", "its ports are not those of a node")
    stream = _text(txt, b"stream")
    if not 0 < len(stream) <= MAX_NAME:
        raise WireError("malformed", "its stream has no name")
    node = _hex(txt, b"id", NODE_BYTES)
    known = _hex(txt, b"key", FINGERPRINT_BYTES) if txt.get(b"key") is not None else None
    return Announcement(name, stream, node, _usable(addresses), port, known)


def _usable(addresses: Sequence[bytes]) -> tuple[str, ...]:
    """Return the addresses that a node can have, those of IPv4 first. Raises WireError.

    An IPv6 address of one link alone has no meaning without the receiver's interface.
    """
    if len(addresses) > MAX_ADDRESSES:
        raise WireError("malformed", f"it has more than {MAX_ADDRESSES} addresses")
    numbers = {ipaddress.ip_address(address) for address in addresses if len(address) in (4, 16)}
    usable = [
        n
        for n in sorted(numbers, key=lambda n: (n.version, n))
        if not (n.is_multicast or n.is_unspecified)
        and (n.version == 4 or not (n.is_link_local or n.ipv4_mapped))
    ]
    if not usable:
        raise WireError("malformed", "it has no address")
    return tuple(map(str, usable))


def _text(txt: Mapping[bytes, bytes | None], key: bytes) -> str:
    try:
        text = (txt.get(key) or b"").decode()
    except UnicodeDecodeError:
        text = "\0"
    if not text.isprintable():
        raise WireError("malformed", f"its {key.decode()} is no text")
    return text


def _hex(txt: Mapping[bytes, bytes | None], key: bytes, length_bytes: int) -> str:
    digits = _text(txt, key)
    if len(digits) != 2 * length_bytes or set(digits) - set("0123456789abcdef"):
        raise WireError("malformed", f"its {key.decode()} is not {length_bytes} bytes in hex")
    return digits


def _cut(text: str, size_bytes: int) -> str:
    return text.encode()[:size_bytes].decode(errors="ignore")


def matching(
    found: Iterable[Announcement], name: str | None, fingerprint: str | None
) -> list[Announcement]:
    """Return the announcements with that name and that key; None matches any."""
    return [
        one
        for one in found
        if (name is None or one.name.casefold() == name.casefold())
        and (fingerprint is None or one.fingerprint == fingerprint)
    ]


def only_match(candidates: Sequence[Announcement]) -> Announcement:
    """Return the only candidate. Raises DiscoveryError where there are several or none."""
    if not candidates:
        raise DiscoveryError("the sensing node that was found has just gone")
    if len(candidates) > 1:
        names = ", ".join(repr(name) for name in sorted(one.name for one in candidates))
        raise DiscoveryError(
            f"{len(candidates)} sensing nodes are announced: {names}; choose one by --named NAME"
        )
    return candidates[0]


def announced_addresses(host: str, own: Iterable[Interface]) -> list[str]:
    """Return the addresses to announce for a node that is bound to `host`.

    host: an address, or all of them ("*", "[::]"). own: this machine's addresses. Raises
    DiscoveryError when there is no address to announce.
    """
    if host in EVERYWHERE:
        reason = "this machine is on no network"
        versions = (4, 6) if host == "[::]" else (4,)
        found = [str(one.ip) for one in own if one.version in versions and not one.ip.is_loopback]
    else:
        reason = "is no address here"
        found = [str(one.ip) for one in own if str(one.ip) == host.strip("[]")]
    if not found:
        raise DiscoveryError(f"--announce: {host}: {reason}; there is nothing to announce")
    return found


def reachable(announcement: Announcement, own: Sequence[Interface]) -> list[str]:
    """Return the announced addresses that are on networks of this machine.

    For a node on this machine, one address is returned. For any other node, addresses that this
    machine has too are left out: container bridges have the same address on many machines. An
    IPv6 address is returned only where there is none of IPv4, since it leads over the same network.
    """
    ours = {str(one.ip) for one in own}
    if ours.issuperset(announcement.addresses):
        return [announcement.addresses[0]]
    there = map(ipaddress.ip_address, (a for a in announcement.addresses if a not in ours))
    near = [a for a in there if any(a in one.network for one in own)]
    first = near[0].version if near else 4
    return [str(address) for address in near if address.version == first]
