"""Keys of a soak's nodes."""

from dataclasses import dataclass
from pathlib import Path

from protocol.cli_options import ALLOWED
from protocol.security.allow_list import allow
from protocol.security.keys import ClientKeys, new_pair, read_pair

WRIST, FINGER, MONITOR = "wrist", "finger", "monitor"


@dataclass(frozen=True, slots=True)
class Keyring:
    """Keys in a folder: of sensing nodes, of displays, and of the listener beside a sensing node.

    Floods and impostors have none.
    """

    folder: Path

    def make(self) -> "Keyring":
        """Make all keys. Raises KeyFileError."""
        for name in (WRIST, FINGER, MONITOR):
            new_pair(self.folder, name)
            if name != WRIST:
                allow(self.folder / ALLOWED, read_pair(self._file(name)).public)
        return self

    @property
    def sensing(self) -> tuple[str, ...]:
        """Return a sensing node's options."""
        return "--key", str(self._file(WRIST))

    @property
    def display(self) -> tuple[str, ...]:
        """Return a display's options."""
        return "--key", str(self._file(FINGER)), "--peer", str(self.folder / f"{WRIST}.pub")

    @property
    def monitor(self) -> ClientKeys:
        """Return the keys of the listener."""
        return ClientKeys(read_pair(self._file(MONITOR)), read_pair(self._file(WRIST)).public)

    def _file(self, name: str) -> Path:
        return self.folder / f"{name}.key"
