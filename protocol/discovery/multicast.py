"""The library behind discovery, and the networks that it speaks on."""

import socket
from ipaddress import IPv4Interface

from protocol.errors import DiscoveryError

try:
    import ifaddr
    from zeroconf import Error as ZeroconfError
    from zeroconf import IPVersion, ServiceBrowser, ServiceInfo, ServiceStateChange, Zeroconf
except ImportError as error:
    raise DiscoveryError(
        f"discovery needs zeroconf, which cannot be loaded ({error});"
        " pip install 'telepulse[discover]'"
    ) from None

__all__ = ["ServiceBrowser", "ServiceInfo", "ServiceStateChange", "Zeroconf", "ZeroconfError"]

GROUP = ("224.0.0.251", 5353)


def own_addresses() -> tuple[list[IPv4Interface], dict[str, list[str]]]:
    """This machine's IPv4 addresses with their networks, and those of each interface by name."""
    own: list[IPv4Interface] = []
    names: dict[str, list[str]] = {}
    for adapter in ifaddr.get_adapters():
        for address in adapter.ips:
            if address.is_IPv4:
                own.append(IPv4Interface(f"{address.ip}/{address.network_prefix}"))
                names.setdefault(adapter.name, []).append(str(address.ip))
    return own, names


def speaking_on(addresses: list[str]) -> Zeroconf:
    """Multicast DNS on the networks of these addresses. Raises DiscoveryError."""
    able = [address for address in addresses if _carries_multicast(address)]
    if not able:
        raise DiscoveryError(
            f"no network here carries multicast ({', '.join(addresses) or 'there is none'}), which"
            " discovery needs; give the sensing node's address: --connect tcp://HOST:5555"
        )
    try:
        return Zeroconf(interfaces=able, ip_version=IPVersion.V4Only)
    except OSError as error:
        raise DiscoveryError(f"multicast DNS cannot be spoken here: {error.strerror}") from None


def _carries_multicast(address: str) -> bool:
    """Whether the kernel has a way to the group from there; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        try:
            one.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(address))
            one.connect(GROUP)
        except OSError:
            return False
    return True
