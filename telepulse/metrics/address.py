"""Where metrics are served: [ADDRESS:]PORT."""

import re

from protocol.errors import AddressError

LOOPBACK = "127.0.0.1"
MAX_PORT = 65_535
_WHERE = re.compile(r"(?:(?P<host>\[[0-9A-Fa-f:.]+\]|[^\s:\[\]]+):)?(?P<port>[0-9]{1,5})")


def parse_address(text: str) -> tuple[str, int]:
    """Host and port; without a host, this machine alone. Raises AddressError."""
    match = _WHERE.fullmatch(text)
    if match is None or int(match["port"]) > MAX_PORT:
        raise AddressError(
            f"--metrics {text}: not a port; write 9100, or ADDRESS:9100 for other machines"
        )
    return (match["host"] or LOOPBACK).strip("[]"), int(match["port"])
