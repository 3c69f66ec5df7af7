"""Which of the announced nodes a display connects to. Pure."""

from collections.abc import Iterable, Sequence

from protocol.discovery.announcement import Announcement
from protocol.errors import DiscoveryError


def fitting(
    found: Iterable[Announcement], name: str | None, fingerprint: str | None
) -> list[Announcement]:
    """Those of that name (None: of any) that answer with that key (None: with any, or none)."""
    return [
        one
        for one in found
        if (name is None or one.name.casefold() == name.casefold())
        and (fingerprint is None or one.fingerprint == fingerprint)
    ]


def the_one(candidates: Sequence[Announcement]) -> Announcement:
    """The only one. Raises DiscoveryError where there are several, or it has just gone."""
    if not candidates:
        raise DiscoveryError("the sensing node that was found has just gone")
    several = sorted(candidates, key=lambda one: one.name)
    if len(several) > 1:
        names = ", ".join(repr(one.name) for one in several)
        raise DiscoveryError(
            f"{len(several)} sensing nodes are announced: {names}; choose one by --named NAME"
        )
    return several[0]
