"""What a sensing node announces of itself, and how it is read. Pure: bytes in, words out.

A DNS-SD service (RFC 6763): its instance's name, its port, its host's addresses and a TXT record.
Anybody on the network can read it, and anybody can send one.

Which of the announced nodes a display connects to. Pure.

Which of a node's addresses to use. Pure.
"""

import hashlib
import ipaddress
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from ipaddress import IPv4Interface

from protocol.errors import DiscoveryError, WireError
from protocol.wire.messages import VERSION
from protocol.wire.stream import MAX_NAME

SERVICE = "_telepulse._tcp.local."
# RFC 6763: of an instance's name, and of a string in a TXT record.
MAX_LABEL_BYTES, MAX_STRING_BYTES = 63, 255
MAX_PORT = 65_534
MAX_ADDRESSES = 16
FINGERPRINT_BYTES, NODE_BYTES = 16, 8


@dataclass(frozen=True, slots=True)
class Announcement:
    """A sensing node: where it streams and whom it lets in.

    name: of the announcement, one of a kind on its network. node: the same after a restart.
    addresses: IPv4, of its host. port: of data; control is one higher. fingerprint: of the public
    key that it answers with; None: it does without keys.
    """

    name: str
    stream: str
    node: str
    addresses: tuple[str, ...]
    port: int
    fingerprint: str | None


def announced(stream: str, host: str, port: int, key: bytes | None) -> Announcement:
    """What a node of these tells, without its addresses; key: its public one."""
    known = None if key is None else fingerprint(key)
    ending = f" on {host}"
    name = _cut(stream, MAX_LABEL_BYTES - len(ending.encode())) + ending
    node = hashlib.blake2b(f"{known or host}:{port}".encode(), digest_size=NODE_BYTES).hexdigest()
    stream = _cut(stream, MAX_STRING_BYTES - len("stream="))
    return Announcement(_cut(name, MAX_LABEL_BYTES), stream, node, (), port, known)


def fingerprint(key: bytes) -> str:
    """A public key in short: the beginning of its SHA-256, in hexadecimal digits."""
    return hashlib.sha256(key).hexdigest()[: 2 * FINGERPRINT_BYTES]


def to_txt(announcement: Announcement) -> dict[str, str]:
    """The TXT record of an announcement."""
    txt = {"v": str(VERSION), "id": announcement.node, "stream": announcement.stream}
    txt["control"] = str(announcement.port + 1)
    if announcement.fingerprint is not None:
        txt["key"] = announcement.fingerprint
    return txt


def read_announcement(
    instance: str,
    addresses: Sequence[bytes],
    port: int | None,
    txt: Mapping[bytes, bytes | None],
) -> Announcement:
    """The announcement of an instance of the service. Raises WireError: "version" where the node
    speaks another one, else "malformed"."""
    name = instance.removesuffix("." + SERVICE)
    if name == instance or not name or not name.isprintable() or len(name) > MAX_LABEL_BYTES:
        raise WireError("malformed", "its name is no node's")
    if _word(txt, b"v") != str(VERSION):
        raise WireError("version", f"it speaks another version than {VERSION}")
    if port is None or not 0 < port <= MAX_PORT or _word(txt, b"control") != str(port + 1):
        raise WireError("malformed", "its ports are none of a node")
    stream = _word(txt, b"stream")
    if not 0 < len(stream) <= MAX_NAME:
        raise WireError("malformed", "its stream has no name")
    node = _hex(txt, b"id", NODE_BYTES)
    known = _hex(txt, b"key", FINGERPRINT_BYTES) if txt.get(b"key") is not None else None
    return Announcement(name, stream, node, _numbers(addresses), port, known)


def _numbers(addresses: Sequence[bytes]) -> tuple[str, ...]:
    """IPv4 addresses that a node can have. Raises WireError."""
    if len(addresses) > MAX_ADDRESSES:
        raise WireError("malformed", f"it has more than {MAX_ADDRESSES} addresses")
    numbers = [ipaddress.IPv4Address(address) for address in addresses if len(address) == 4]
    usable = sorted({n for n in numbers if not (n.is_multicast or n.is_unspecified)})
    if not usable:
        raise WireError("malformed", "it has no address")
    return tuple(map(str, usable))


def _word(txt: Mapping[bytes, bytes | None], key: bytes) -> str:
    try:
        word = (txt.get(key) or b"").decode()
    except UnicodeDecodeError:
        word = "\0"
    if not word.isprintable():
        raise WireError("malformed", f"its {key.decode()} is no text")
    return word


def _hex(txt: Mapping[bytes, bytes | None], key: bytes, length_bytes: int) -> str:
    word = _word(txt, key)
    if len(word) != 2 * length_bytes or set(word) - set("0123456789abcdef"):
        raise WireError("malformed", f"its {key.decode()} is none")
    return word


def _cut(text: str, size_bytes: int) -> str:
    return text.encode()[:size_bytes].decode(errors="ignore")


def matching(
    found: Iterable[Announcement], name: str | None, fingerprint: str | None
) -> list[Announcement]:
    """Those of that name (None: of any) that answer with that key (None: with any, or none)."""
    return [
        one
        for one in found
        if (name is None or one.name.casefold() == name.casefold())
        and (fingerprint is None or one.fingerprint == fingerprint)
    ]


def only_match(candidates: Sequence[Announcement]) -> Announcement:
    """The only one. Raises DiscoveryError where there are several, or it has just gone."""
    if not candidates:
        raise DiscoveryError("the sensing node that was found has just gone")
    several = sorted(candidates, key=lambda one: one.name)
    if len(several) > 1:
        names = ", ".join(repr(one.name) for one in several)
        raise DiscoveryError(
            f"{len(several)} sensing nodes are announced: {names}; choose one by --named NAME"
        )
    return several[0]


EVERYWHERE = ("*", "0.0.0.0")


def announced_addresses(
    host: str, own: Iterable[IPv4Interface], names: dict[str, list[str]]
) -> list[str]:
    """The addresses to announce of a node that is bound to `host`.

    own: this machine's addresses; names: those of each interface, by its name. Raises
    DiscoveryError where there are none.
    """
    addresses = [str(one.ip) for one in own]
    if host in EVERYWHERE:
        found = [str(one.ip) for one in own if not one.ip.is_loopback]
    elif host in names:
        found = names[host]
    else:
        found = [address for address in addresses if address == host]
    if not found:
        reason = (
            "this machine is on no network" if host in EVERYWHERE else "is no IPv4 address here"
        )
        raise DiscoveryError(f"--announce: {host}: {reason}; there is nothing to announce")
    return found


def reachable(announcement: Announcement, own: Sequence[IPv4Interface]) -> list[str]:
    """Its addresses on networks that this machine is on: only from there is it announced.

    Of a node on this very machine, one; else none that this machine has itself, for two may have
    the same address on networks of their own (container bridges).
    """
    ours = {str(one.ip) for one in own}
    if ours.issuperset(announcement.addresses):
        return [announcement.addresses[0]]
    there = [address for address in announcement.addresses if address not in ours]
    return [a for a in there if any(IPv4Interface(a).ip in one.network for one in own)]
