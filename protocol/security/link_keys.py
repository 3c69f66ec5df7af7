"""The keys of one link: from the options of a command to the sockets of either end.

A node that binds has its own pair and an allow-list, which `Authenticator` applies. A node that
connects has its own pair and the public key of the other node.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Self

import zmq

from protocol.errors import ProtectionError
from protocol.security.allow_list import FILE_NAME, AllowList
from protocol.security.keys import KeyPair, PublicKey, read_pair, read_public
from protocol.sockets import Socket, beyond_loopback, control_address


@dataclass(frozen=True, slots=True)
class ServerKeys:
    """Keys of a node that binds: its own pair, and the keys that may connect."""

    own: KeyPair
    allow_list: AllowList


@dataclass(frozen=True, slots=True)
class ClientKeys:
    """Keys of a node that connects: its own pair, and the public key of the other node."""

    own: KeyPair
    peer: PublicKey

    @classmethod
    def of_own_node(cls, key: Path) -> Self:
        """Return the keys for connecting to the node that has this key itself."""
        pair = read_pair(key)
        return cls(pair, pair.public)

    def protect(self, socket: Socket) -> None:
        """Make `socket` connect only to the peer, encrypted; call this before it connects."""
        socket.setsockopt(zmq.CURVE_SECRETKEY, self.own.secret)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self.own.public.key)
        socket.setsockopt(zmq.CURVE_SERVERKEY, self.peer.key)


@dataclass(frozen=True)
class KeyOptions:
    """The options of a command that protect its links: --key, --peer, --allow, --insecure.

    Its methods return the keys of one link, or None for a link without keys. Each key file is read
    once, however many links there are. They raise ProtectionError where keys are required or the
    options do not fit, AddressError, and KeyFileError.
    """

    key: Path | None = None
    peer: Path | None = None
    allow: Path | None = None
    insecure: bool = False

    def server(self, address: str) -> ServerKeys | None:
        """Return the keys for sockets bound to `address`."""
        if self.key is None and self.allow is not None:
            raise ProtectionError(f"--allow {self.allow} needs this node's own key: --key FILE.key")
        self._check_insecure(self.key is not None, [address], "--key keys/NAME.key")
        if self.key is None:
            return None
        if self.allow is not None and not self.allow.exists():
            raise ProtectionError(f"--allow {self.allow}: there is no such file")
        return ServerKeys(self.own, AllowList(self.allow or self.key.with_name(FILE_NAME)))

    def telemetry_server(self, address: str) -> ServerKeys | None:
        """Return the keys for publishing telemetry; on this machine it needs none."""
        if beyond_loopback(address):
            return self.server(address)
        if self.allow is not None:
            raise ProtectionError(
                f"--allow is for telemetry beyond this machine, and {address} stays on it"
            )
        return None

    def client(self, *addresses: str) -> ClientKeys | None:
        """Return the keys for sockets that connect to `addresses`."""
        for address in addresses:
            control_address(address)
        keyed = self.key is not None or self.peer is not None
        self._check_insecure(keyed, addresses, "--key keys/NAME.key --peer keys/PEER.pub")
        if not keyed:
            return None
        if self.key is None:
            raise ProtectionError(f"--peer {self.peer} needs this node's own key: --key FILE.key")
        if self.peer is None:
            raise ProtectionError(
                f"--key {self.key} needs the other node's public key: --peer FILE.pub"
            )
        return ClientKeys(self.own, self.peer_key)

    def forwarder(self, address: str) -> ClientKeys | None:
        """Return a forwarder's keys for connecting to the sensing node at `address`.

        Without a peer, that node is on this machine and has no keys; a key is for the displays.
        """
        return (self if self.peer else replace(self, key=None)).client(address)

    def telemetry_client(self, address: str) -> ClientKeys | None:
        """Return the keys for reading a display's telemetry; without a peer, the key is its own."""
        if self.key is not None and self.peer is None:
            return ClientKeys.of_own_node(self.key)
        return self.client(address)

    @cached_property
    def peer_key(self) -> PublicKey:
        """Public key of --peer, which must be given."""
        assert self.peer is not None
        return read_public(self.peer)

    @cached_property
    def own(self) -> KeyPair:
        """Key pair of --key, which must be given."""
        assert self.key is not None
        return read_pair(self.key)

    def _check_insecure(self, keyed: bool, addresses: Sequence[str], options: str) -> None:
        """Check that a link has keys, stays on this machine, or is explicitly insecure."""
        if keyed and self.insecure:
            raise ProtectionError("--insecure does without keys, and --key is given: choose one")
        for address in addresses:
            if beyond_loopback(address) and not keyed and not self.insecure:
                raise ProtectionError(
                    f"{address} reaches beyond this machine without keys; make them by"
                    f" 'telepulse keys new NAME' and give {options}, or give --insecure"
                )
