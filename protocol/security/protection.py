"""Command-line options of a protected link, and the keys that they name."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from protocol.errors import ProtectionError
from protocol.security.allow_list import read_allowed
from protocol.security.keys import ClientKeys, ServerKeys, read_pair, read_public
from protocol.sockets import beyond_loopback, control_address

ALLOWED = "allowed"

KeyOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.key", help="This node's secret key; make one by: telepulse keys new NAME."
    ),
]
PeerOption = Annotated[
    Path | None, typer.Option(metavar="FILE.pub", help="Public key of the node to connect to.")
]
AllowOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Public keys that may connect; by default the file 'allowed' beside the key.",
    ),
]
InsecureOption = Annotated[
    bool, typer.Option("--insecure", help="Allow links beyond this machine without keys.")
]


def server_keys(
    address: str, key: Path | None, allow: Path | None, insecure: bool
) -> ServerKeys | None:
    """Return the keys for sockets bound to `address`; None for a link without keys.

    Raises ProtectionError where keys are required or the options do not fit; KeyFileError.
    """
    if key is None:
        if allow is not None:
            raise ProtectionError(f"--allow {allow} needs this node's own key: --key FILE.key")
        _require_keys(address, insecure, "--key keys/NAME.key")
        return None
    _refuse_insecure(insecure)
    if allow is not None and not allow.exists():
        raise ProtectionError(f"--allow {allow}: there is no such file")
    allowed = allow or key.with_name(ALLOWED)
    read_allowed(allowed)
    return ServerKeys(read_pair(key), allowed)


def client_keys(
    addresses: Sequence[str], key: Path | None, peer: Path | None, insecure: bool
) -> ClientKeys | None:
    """Return the keys for sockets that connect to `addresses`; None for a link without keys.

    Raises ProtectionError where keys are required or the options do not fit; AddressError;
    KeyFileError.
    """
    for address in addresses:
        control_address(address)
    if key is None and peer is None:
        for address in addresses:
            _require_keys(address, insecure, "--key keys/NAME.key --peer keys/PEER.pub")
        return None
    _refuse_insecure(insecure)
    if key is None:
        raise ProtectionError(f"--peer {peer} needs this node's own key: --key FILE.key")
    if peer is None:
        raise ProtectionError(f"--key {key} needs the other node's public key: --peer FILE.pub")
    return ClientKeys(read_pair(key), read_public(peer))


def telemetry_keys(
    address: str, key: Path | None, peer: Path | None, insecure: bool
) -> ClientKeys | None:
    """Return the keys for reading a display's telemetry.

    A key without a peer is the display's own. Raises as `client_keys` does.
    """
    if key is not None and peer is None:
        pair = read_pair(key)
        return ClientKeys(pair, pair.public)
    return client_keys([address], key, peer, insecure)


def _require_keys(address: str, insecure: bool, options: str) -> None:
    if beyond_loopback(address) and not insecure:
        raise ProtectionError(
            f"{address} reaches beyond this machine without keys; make them by"
            f" 'telepulse keys new NAME' and give {options}, or do without by --insecure"
        )


def _refuse_insecure(insecure: bool) -> None:
    if insecure:
        raise ProtectionError("--insecure does without keys, and --key is given: choose one")
