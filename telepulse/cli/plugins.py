"""`telepulse plugins`: list the kinds of a scene's tables, and the distributions they come from."""

from protocol.cli_options import plain_console
from telepulse.plugins import GROUPS


def plugins() -> None:
    """List the kinds of sources, sensors, drives, actuators and predictors.

    Each line names a group of entry points, a kind, and the distribution that it comes from, with
    its version and, where it cannot be used, the reason.

    Exit status: 0; 1 when a kind cannot be used.
    """
    console, listed = plain_console(), [each for group in GROUPS for each in group.listed()]
    group, kind = (max(len(getattr(each, key)) for each in listed) for key in ("group", "kind"))
    for each in listed:
        line = f"{each.group:{group}}  {each.kind:{kind}}  {each.distribution}"
        problem = "" if each.problem is None else f"  {each.problem}"
        console.print(f"{line} {each.version}{problem}", markup=False, soft_wrap=True)
    if any(each.problem for each in listed):
        raise SystemExit(1)
