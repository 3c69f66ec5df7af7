"""Key files for tests, as `telepulse keys` makes them."""

from pathlib import Path

from protocol.security.allow_list import AllowList, allow
from protocol.security.keys import KeyPair, new_pair, read_pair
from protocol.security.link_keys import ClientKeys, ServerKeys


class Keyring:
    """A folder of keys, each made at its first use; "wrist" serves, others connect."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.allowed = folder / "allowed"

    def path(self, name: str, kind: str = "key") -> str:
        """Return a key file; kind: "key" is secret, "pub" public."""
        self.pair(name)
        return str(self.folder / f"{name}.{kind}")

    def pair(self, name: str) -> KeyPair:
        if not (self.folder / f"{name}.key").exists():
            new_pair(self.folder, name)
        return read_pair(self.folder / f"{name}.key")

    def allow(self, *names: str) -> None:
        for name in names:
            allow(self.allowed, self.pair(name).public)

    def server(self) -> ServerKeys:
        """Return the keys with which wrist binds."""
        return ServerKeys(self.pair("wrist"), AllowList(self.allowed))

    def client(self, name: str, peer: str = "wrist") -> ClientKeys:
        """Return the keys with which a name connects to `peer`."""
        return ClientKeys(self.pair(name), self.pair(peer).public)
