"""Which of a node's addresses to use. Pure."""

from collections.abc import Iterable, Sequence
from ipaddress import IPv4Interface

from protocol.discovery.announcement import Announcement
from protocol.errors import DiscoveryError

EVERYWHERE = ("*", "0.0.0.0")


def told_of(host: str, own: Iterable[IPv4Interface], names: dict[str, list[str]]) -> list[str]:
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
