"""Finding the sensing node on the local network, before the display's loop begins."""

import logging
import math
import time
from collections.abc import Callable
from pathlib import Path

from protocol.discovery.announcement import Announcement, fingerprint, matching, only_match
from protocol.errors import DiscoveryError, ProtectionError
from protocol.security.keys import read_public

logger = logging.getLogger(__name__)

# After the first that fits, for others that do.
GATHER_S = 2.0
SAY_AFTER_S = 5.0
LOOK_EVERY_S = 0.05


def discovered(name: str | None, peer: Path | None, seconds: float | None) -> list[str]:
    """Return the addresses of the one sensing node that announces itself on this network.

    name: its name; None accepts any. peer: file of its public key; None accepts any. seconds:
    longest wait for one.

    Raises DiscoveryError where several fit or none comes, ProtectionError where it demands keys
    and there is no `peer`, KeyFileError.
    """
    # It brings the library, which others do without.
    from protocol.discovery.browser import Browser

    known = None if peer is None else fingerprint(read_public(peer).key)
    with Browser() as look:
        logger.info("looking for a sensing node on the local network")

        def fit() -> list[Announcement]:
            return matching(look.found, name, known)

        _await_first(lambda: look.found, fit, seconds)
        if name is None:
            time.sleep(GATHER_S)
        one = only_match(fit())
        refused = look.refused.total()
    if refused:
        logger.warning(f"{refused} announcements were not a sensing node's")
    if one.fingerprint is not None and peer is None:
        raise ProtectionError(
            f"{one.name!r} lets in who has a key; give --key keys/NAME.key --peer keys/PEER.pub"
        )
    addresses = [f"tcp://{address}:{one.port}" for address in one.addresses]
    logger.info(f"found {one.name!r} at {', '.join(addresses)}")
    return addresses


def _await_first(
    found: Callable[[], list[Announcement]],
    fit: Callable[[], list[Announcement]],
    seconds: float | None,
) -> None:
    """Wait until one fits. Raises DiscoveryError when none does in time."""
    begin_s, said = time.monotonic(), False
    while not fit():
        waited_s = time.monotonic() - begin_s
        if waited_s > (math.inf if seconds is None else seconds):
            raise DiscoveryError(f"within {seconds:g} s {_who(found())}")
        if waited_s > SAY_AFTER_S and not said:
            said = True
            logger.info(f"so far {_who(found())}; waiting on")
        time.sleep(LOOK_EVERY_S)


def _who(found: list[Announcement]) -> str:
    if not found:
        return "no sensing node has announced itself (there: sensing-node --announce)"
    names = ", ".join(repr(one.name) for one in found)
    return f"only others have announced themselves, of another name or key than wanted: {names}"
