"""Check of HTTP requests to one of our servers by their Host and Origin headers.

Another site can let its own name resolve to this machine (DNS rebinding). A browser then treats our
server as part of that site, and lets the site's pages read our responses. The request's headers
still contain the site's name, so only requests to a name or address of this server are served.
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

    names: in lower case, without ports. any_address: the server is bound to all addresses of its
    machine, and every IP address is accepted as its name: DNS rebinding needs a name.
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

        host, origin: the request's headers. A browser sends Origin with the requests of a page, and
        that page must come from this server.
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
    """Return a host in the notation of a URL."""
    return f"[{host}]" if ":" in host else host


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name)
    except ValueError:
        return None


def _ascii(text: str) -> str:
    """Return a header's text, cut, in ASCII."""
    return ascii(text[:SHOWN_CHARACTERS])[1:-1]
