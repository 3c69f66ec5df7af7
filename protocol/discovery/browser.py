"""Search of the local network for sensing nodes that announce themselves, by zeroconf."""

import logging
import socket
from collections import Counter
from dataclasses import replace
from ipaddress import ip_address, ip_interface

from protocol.discovery.announcement import (
    SERVICE,
    Announcement,
    Interface,
    reachable,
    read_announcement,
)
from protocol.errors import DiscoveryError, WireError

logger = logging.getLogger(__name__)

try:
    import ifaddr
    from zeroconf import Error as ZeroconfError
    from zeroconf import IPVersion, ServiceBrowser, ServiceInfo, ServiceStateChange, Zeroconf
except ImportError as error:
    raise DiscoveryError(
        f"discovery needs zeroconf, which cannot be loaded ({error});"
        " pip install 'telepulse[discover]'"
    ) from None

__all__ = ["Browser", "ServiceInfo", "ZeroconfError", "open_multicast", "own_addresses"]

MULTICAST_GROUP = ("224.0.0.251", 5353)
# The same of a site, since that of a link needs an interface; only the route is looked up.
GROUP_OF_IPV6 = ("ff05::fb", 5353)
# More nodes than any one network has; further names are counted only.
MAX_NAMES = 256
# Longest wait for a name's other records; a node sends them together with the name.
REQUEST_WITHIN_MS = 500
# Number of refusals that are logged (further ones are counted only), and characters of a name.
MAX_LOGGED, NAME_CHARACTERS = 20, 80
UNREACHABLE, TOO_MANY = "unreachable", "too_many"


class Browser:
    """Search in threads of its own, from construction until the end of a `with`.

    refused: counts of announcements that are not valid, by cause. Raises DiscoveryError where no
    network of this machine carries multicast.
    """

    def __init__(self) -> None:
        self._own, _ = own_addresses()
        self._found: dict[str, Announcement] = {}
        self._seen: set[str] = set()
        self.refused: Counter[str] = Counter()
        self._network = open_multicast([str(one.ip) for one in self._own])
        self._browser = ServiceBrowser(self._network, SERVICE, handlers=[self._on_change])

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self._browser.cancel()
        self._network.close()

    @property
    def found(self) -> list[Announcement]:
        """Announced nodes that can be reached, each with the `addresses` that can."""
        return list(self._found.values())

    def _on_change(
        self, zeroconf: Zeroconf, service_type: str, name: str, state_change: ServiceStateChange
    ) -> None:
        if state_change is ServiceStateChange.Removed:
            self._found.pop(name, None)
            return
        if name not in self._seen and len(self._seen) >= MAX_NAMES:
            self._refuse(TOO_MANY, name, f"more than {MAX_NAMES} are announced")
            return
        self._seen.add(name)
        try:
            self._found[name] = self._read(zeroconf, name)
        except WireError as error:
            self._found.pop(name, None)
            self._refuse(error.cause, name, str(error))

    def _read(self, zeroconf: Zeroconf, name: str) -> Announcement:
        try:
            info = ServiceInfo(SERVICE, name)
            answered = info.request(zeroconf, REQUEST_WITHIN_MS)
        except ZeroconfError as error:
            raise WireError("malformed", ascii(str(error))) from None
        if not answered:
            raise WireError("malformed", "its host does not send its address")
        packed = info.addresses_by_version(IPVersion.All)
        announcement = read_announcement(name, packed, info.port, info.properties)
        addresses = reachable(announcement, self._own)
        if not addresses:
            raise WireError(UNREACHABLE, "none of its addresses is on a network of this machine")
        return replace(announcement, addresses=tuple(addresses))

    def _refuse(self, cause: str, name: str, reason: str) -> None:
        self.refused[cause] += 1
        if self.refused.total() <= MAX_LOGGED:
            # The name comes from the network: only ASCII that every terminal shows is printed.
            shown = ascii(name.removesuffix("." + SERVICE))[1:-1][:NAME_CHARACTERS]
            logger.warning(f"not a sensing node: {shown}: {reason}")


def own_addresses() -> tuple[list[Interface], dict[str, list[str]]]:
    """Return this machine's addresses with their networks, and those of IPv4 by interface.

    Two kinds of IPv6 addresses are left out: those of one link alone, which differ by interface and
    not by network, and that of loopback, which carries no multicast.
    """
    own: list[Interface] = []
    names: dict[str, list[str]] = {}
    for adapter in ifaddr.get_adapters():
        for address in adapter.ips:
            ip = address.ip if isinstance(address.ip, str) else address.ip[0]
            one = ip_interface(f"{ip}/{address.network_prefix}")
            if one.version == 4:
                names.setdefault(adapter.name, []).append(ip)
            if one.version == 4 or not (one.ip.is_link_local or one.ip.is_loopback):
                own.append(one)
    return own, names


def open_multicast(addresses: list[str]) -> Zeroconf:
    """Open multicast DNS on the networks of these addresses. Raises DiscoveryError."""
    able = [address for address in addresses if _carries_multicast(address)]
    if not able:
        raise DiscoveryError(
            f"no network here carries multicast ({', '.join(addresses) or 'there is none'}), which"
            " discovery needs; give the sensing node's address: --connect tcp://HOST:5555"
        )
    versions = {ip_address(address).version for address in able}
    ip_version = IPVersion.All
    if len(versions) == 1:
        ip_version = IPVersion.V4Only if versions == {4} else IPVersion.V6Only
    try:
        return Zeroconf(interfaces=able, ip_version=ip_version)
    except OSError as error:
        raise DiscoveryError(f"multicast DNS cannot be opened here: {error.strerror}") from None


def _carries_multicast(address: str) -> bool:
    """Return whether the kernel has a route from an address to the group; nothing is sent."""
    family, group = (
        (socket.AF_INET6, GROUP_OF_IPV6) if ":" in address else (socket.AF_INET, MULTICAST_GROUP)
    )
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        try:
            if family == socket.AF_INET:
                interface = socket.inet_aton(address)
                probe.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
            else:
                probe.bind((address, 0))
            probe.connect(group)
        except OSError:
            return False
    return True
