"""Keys for tests: files as `telepulse keys` makes them."""

from pathlib import Path

from protocol.security.allow_list import allow
from protocol.security.keys import ClientKeys, KeyPair, ServerKeys, new_pair, read_pair


class Keyring:
    """A folder of keys, made when they are asked for; wrist serves, others connect."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.allowed = folder / "allowed"

    def path(self, name: str, kind: str = "key") -> str:
        """The file of a name, secret or public (`kind` pub)."""
        self.pair(name)
        return str(self.folder / f"{name}.{kind}")

    def pair(self, name: str) -> KeyPair:
        """The pair of a name."""
        if not (self.folder / f"{name}.key").exists():
            new_pair(self.folder, name)
        return read_pair(self.folder / f"{name}.key")

    def allow(self, name: str) -> None:
        """Let a name in."""
        allow(self.allowed, self.pair(name).public)

    def server(self) -> ServerKeys:
        """What wrist binds with."""
        return ServerKeys(self.pair("wrist"), self.allowed)

    def client(self, name: str, peer: str = "wrist") -> ClientKeys:
        """What a name connects to `peer` with."""
        return ClientKeys(self.pair(name), self.pair(peer).public)
