"""Check of HTTP requests to a server of ours by their Host and Origin headers.

A page of another site may let its own name resolve to this machine (DNS rebinding). A browser then
takes our server for that site's, and lets the page read its answers. The name stays in the
request's headers, so a request is served only under a name or address of this server.
"""

import ipaddress
import socket
from dataclasses import dataclass
from urllib.parse import urlsplit

LOOPBACK = ("127.0.0.1", "localhost", "::1")
# A header in a refusal is cut to this length.
SHOWN_CHARACTERS = 60


@dataclass(frozen=True, slots=True)
class Site:
    """The names under which one server is served.

    names: in lower case, without ports. any_address: every IP address is one of them, where the
    server is bound to all addresses of its machine. A rebound name is never an address.
    """

    names: frozenset[str]
    any_address: bool = False

    @classmethod
    def at(cls, host: str) -> "Site":
        """Return the site of a server that is bound to `host`, a name or an IP address."""
        names = {host.lower(), socket.gethostname().lower()}
        address = _address(host)
        everywhere = address is not None and address.is_unspecified
        if host.lower() == "localhost" or everywhere or (address and address.is_loopback):
            names.update(LOOPBACK)
        return cls(frozenset(names), everywhere)

    def refusal(self, host: str, origin: str | None) -> str | None:
        """Return why a request is refused, in one line; None where it is served.

        host, origin: the request's headers. A browser sends Origin with what a page asks for; it
        has to be the page that this server itself has sent.
        """
        if not self._is_own(host):
            return f"{_ascii(host)} is not this server's name; open it by its own address"
        if origin is not None and urlsplit(origin).netloc.lower() != host.lower():
            return f"pages of {_ascii(origin)} may not read this server"
        return None

    def _is_own(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname
        except ValueError:
            return False
        name = (name or "").rstrip(".")
        return name in self.names or (self.any_address and _address(name) is not None)


def in_url(host: str) -> str:
    """Return a host as it stands in a URL."""
    return f"[{host}]" if ":" in host else host


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def _ascii(text: str) -> str:
    """Return a header's text, cut, in ASCII."""
    return ascii(text[:SHOWN_CHARACTERS])[1:-1]
