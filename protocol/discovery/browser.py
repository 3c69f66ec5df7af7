"""Search of the local network for sensing nodes that announce themselves, by zeroconf."""

import logging
from collections import Counter
from dataclasses import replace
from ipaddress import ip_interface

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

# More nodes than any one network has; further names are counted only.
MAX_NAMES = 256
# Longest wait for a name's other records; a node sends them together with the name.
REQUEST_WITHIN_MS = 500
# Number of refusals that are logged (further ones are counted only), and characters of a name.
MAX_LOGGED, NAME_CHARACTERS = 20, 80
UNREACHABLE, TOO_MANY = "unreachable", "too_many"


class Browser:
    """Search in threads of its own, from construction until the end of a `with`.

    refused: counts of announcements that are not valid, by cause. Raises DiscoveryError where
    multicast DNS cannot be opened.
    """

    def __init__(self) -> None:
        self._own = own_addresses()
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


def own_addresses() -> list[Interface]:
    """Return this machine's addresses with their networks.

    Two kinds of IPv6 addresses are left out: those of one link alone, which differ by interface and
    not by network, and that of loopback, which carries no multicast.
    """
    found = (
        ip_interface(f"{ip.ip if isinstance(ip.ip, str) else ip.ip[0]}/{ip.network_prefix}")
        for adapter in ifaddr.get_adapters()
        for ip in adapter.ips
    )
    return [one for one in found if one.version == 4 or not (one.is_link_local or one.is_loopback)]


def open_multicast(addresses: list[str]) -> Zeroconf:
    """Open multicast DNS on the networks of these addresses. Raises DiscoveryError."""
    try:
        if not addresses:
            raise OSError(None, "there is no network")
        return Zeroconf(interfaces=addresses)
    except OSError as error:
        raise DiscoveryError(
            f"multicast DNS cannot be opened here: {error.strerror}; give the sensing node's"
            " address: --connect tcp://HOST:5555"
        ) from None
