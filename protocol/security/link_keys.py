"""The keys of one link: from the options of a command to the sockets of either end.

As in CURVE, the end that binds is the server, the end that connects the client. The server has its
pair and an allow-list, which `Authenticator` applies; the client has its pair and the server's
public key.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import zmq

from protocol.errors import ProtectionError
from protocol.security.allow_list import AllowList, default_path
from protocol.security.keys import KeyPair, PublicKey, is_missing, read_pair, read_public
from protocol.sockets import Socket, beyond_loopback, control_address


@dataclass(frozen=True, slots=True)
class ServerKeys:
    """Keys of a server: its pair, and the list of the keys that may connect.

    An `Authenticator` is made of them, which then protects the server's sockets: the list decides
    during the whole run, and not only when a socket is bound.
    """

    pair: KeyPair
    allow_list: AllowList


@dataclass(frozen=True, slots=True)
class ClientKeys:
    """Keys of a client: its pair, and the public key of the server."""

    pair: KeyPair
    server_key: PublicKey

    def protect(self, socket: Socket) -> None:
        """Make `socket` connect only to the server, encrypted; call this before it connects."""
        socket.setsockopt(zmq.CURVE_SECRETKEY, self.pair.secret)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self.pair.public.key)
        socket.setsockopt(zmq.CURVE_SERVERKEY, self.server_key.key)


@dataclass(frozen=True)
class KeyOptions:
    """The options of a command that protect its links: --key, --peer, --allow, --insecure.

    Its methods return the keys of one link, or None for a link without keys. They raise
    ProtectionError where keys are required or the options do not fit, AddressError, and
    KeyFileError. A command reads each key file once, however many links it has. The processes that
    a display starts (screen, recorder, metrics server) are commands of their own: each is given the
    path of the display's key, and reads the file again.
    """

    key: Path | None = None
    peer: Path | None = None
    allow: Path | None = None
    insecure: bool = False

    def __post_init__(self) -> None:
        """Raise ProtectionError where keys are given and renounced."""
        if self.insecure and (self.key is not None or self.peer is not None):
            given = "--peer" if self.key is None else "--key"
            raise ProtectionError(f"--insecure does without keys, and {given} is given: choose one")

    @cached_property
    def pair(self) -> KeyPair:
        """Key pair, read from the file of --key at the first use; the option must be given."""
        assert self.key is not None
        return read_pair(self.key)

    @cached_property
    def peer_key(self) -> PublicKey:
        """Public key, read from the file of --peer at the first use; it must be given."""
        assert self.peer is not None
        return read_public(self.peer)

    def server(self, address: str) -> ServerKeys | None:
        """Return the keys of sockets bound to `address`."""
        if self.key is None:
            if self.allow is not None:
                raise ProtectionError(
                    f"--allow {self.allow} needs this node's own key: --key FILE.key"
                )
            self._check_without_keys([address], "--key keys/NAME.key")
            return None
        if self.allow is not None and is_missing(self.allow):
            raise ProtectionError(f"--allow {self.allow}: there is no such file")
        path = self.allow or default_path(self.key.parent)
        return ServerKeys(self.pair, AllowList(path))

    def telemetry_server(self, address: str) -> ServerKeys | None:
        """Return a display's keys for publishing telemetry; on this machine it needs none."""
        if beyond_loopback(address):
            return self.server(address)
        if self.allow is not None:
            raise ProtectionError(
                f"--allow is for telemetry beyond this machine, and {address} stays on it"
            )
        return None

    def client(self, *addresses: str) -> ClientKeys | None:
        """Return the keys of sockets that connect to `addresses`."""
        for address in addresses:
            control_address(address)
        if self.key is None and self.peer is None:
            self._check_without_keys(addresses, "--key keys/NAME.key --peer keys/PEER.pub")
            return None
        if self.key is None:
            raise ProtectionError(f"--peer {self.peer} needs this node's own key: --key FILE.key")
        if self.peer is None:
            raise ProtectionError(
                f"--key {self.key} needs the other node's public key: --peer FILE.pub"
            )
        return ClientKeys(self.pair, self.peer_key)

    def forwarding_client(self, address: str) -> ClientKeys | None:
        """Return a forwarder's keys for connecting to the sensing node at `address`.

        Without a peer, that node is on this machine and has no keys; a key is for the displays.
        """
        return (self if self.peer else replace(self, key=None)).client(address)

    def telemetry_client(self, address: str) -> ClientKeys | None:
        """Return the keys for reading a display's telemetry.

        Without a peer, the key is the display's, which is then client and server in one.
        """
        if self.key is None or self.peer is not None:
            return self.client(address)
        return ClientKeys(self.pair, self.pair.public)

    def _check_without_keys(self, addresses: Sequence[str], options: str) -> None:
        """Check that a link without keys stays on this machine, or is explicitly insecure."""
        for address in addresses:
            if beyond_loopback(address) and not self.insecure:
                raise ProtectionError(
                    f"{address} reaches beyond this machine without keys; make them by"
                    f" 'telepulse keys new NAME' and give {options}, or give --insecure"
                )
