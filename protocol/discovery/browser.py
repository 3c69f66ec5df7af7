"""A look around the local network: which sensing nodes announce themselves."""

from collections import Counter
from collections.abc import Callable
from dataclasses import replace

from protocol.discovery.announcement import SERVICE, Announcement, reachable, read_announcement
from protocol.discovery.multicast import (
    ServiceBrowser,
    ServiceInfo,
    ServiceStateChange,
    Zeroconf,
    ZeroconfError,
    own_addresses,
    speaking_on,
)
from protocol.errors import WireError

# More than one network has; whoever sends more names is not looked at.
MAX_NAMES = 256
# Of a name without the rest, which comes with it where a node speaks.
ASK_FOR_MS = 500
# Refusals that are said; the rest is counted.
MAX_NAMED, MAX_SHOWN = 20, 80
UNREACHABLE, TOO_MANY = "unreachable", "too_many"


class Browser:
    """Looks until closed, by threads of its own. refused: announcements that are none, by cause."""

    def __init__(self, log: Callable[[str], None]) -> None:
        """log is told once of each that is refused. Raises DiscoveryError."""
        self._log = log
        self._own, _ = own_addresses()
        self._found: dict[str, Announcement] = {}
        self._seen: set[str] = set()
        self.refused: Counter[str] = Counter()
        self._network = speaking_on([str(one.ip) for one in self._own])
        self._browser = ServiceBrowser(self._network, SERVICE, handlers=[self._on_change])

    def __enter__(self) -> "Browser":
        return self

    def __exit__(self, *_: object) -> None:
        self._browser.cancel()
        self._network.close()

    @property
    def found(self) -> list[Announcement]:
        """Those that are announced now and can be reached, with the addresses to reach them by."""
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
        """Raises WireError."""
        try:
            info = ServiceInfo(SERVICE, name)
            there = info.request(zeroconf, ASK_FOR_MS)
        except ZeroconfError as error:
            raise WireError("malformed", ascii(str(error))) from None
        if not there:
            raise WireError("malformed", "its host does not say where it is")
        read = read_announcement(name, info.addresses, info.port, info.properties)
        addresses = reachable(read, self._own)
        if not addresses:
            raise WireError(UNREACHABLE, "none of its addresses is on a network of this machine")
        return replace(read, addresses=tuple(addresses))

    def _refuse(self, cause: str, name: str, reason: str) -> None:
        self.refused[cause] += 1
        if self.refused.total() <= MAX_NAMED:
            # In letters that every terminal has: a peer chose it.
            shown = ascii(name.removesuffix("." + SERVICE))[1:-1][:MAX_SHOWN]
            self._log(f"not a sensing node: {shown}: {reason}")
