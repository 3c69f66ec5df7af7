"""What the three command lines share: one way to fail, one way to warn."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from protocol.errors import TelepulseError
from protocol.sockets import beyond_loopback

USAGE_ERROR = 2


@contextmanager
def one_line_errors(program: str) -> Iterator[None]:
    """Turn the project's own errors into one line on stderr and exit status 2."""
    try:
        yield
    except TelepulseError as error:
        print(f"{program}: {error}", file=sys.stderr)
        raise SystemExit(USAGE_ERROR) from None


def warn_if_open(program: str, address: str, insecure: bool) -> None:
    """Say that a link beyond this machine is neither encrypted nor authenticated."""
    if beyond_loopback(address) and not insecure:
        print(
            f"{program}: warning: {address} reaches beyond this machine and is neither encrypted"
            " nor authenticated; use it on a network you trust (--insecure silences this)",
            file=sys.stderr,
        )
