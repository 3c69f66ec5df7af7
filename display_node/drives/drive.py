"""What every drive does for the force loop, whatever it is reached by."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from display_node.drives.withdrawal import WithdrawalOutcome


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """What a drive said last.

    position_m: of the tip from first touch, positive into the finger; heard_ns: when it was
    received, on the monotonic clock, 0 before any was. fault: what has ended the following of
    commands until `Drive.start` is called again, or None. withdrawal: how far the tip has come off
    the finger since; None without a fault, and where the drive was not moving by our commands.
    answered_ns: when the drive answered anything. held_back: the last command was slowed before
    the far end of the travel.
    """

    position_m: float
    speed_m_per_s: float
    fault: str | None
    moving: bool
    heard_ns: int
    withdrawal: WithdrawalOutcome | None = None
    answered_ns: int = 0
    held_back: bool = False


def no_film() -> None:
    """Return no reading, where no film lies under the finger."""


class Drive(Protocol):
    """A stepper's drive that takes speeds.

    counts: what went wrong on the way to it and was made good, by name.
    """

    counts: Counter[str]

    def start(self, force_n: Callable[[], float | None] = no_film) -> None:
        """Connect, check, enable, home, verify the direction and come to first touch; blocks.

        force_n gives the newest reading of the film under the finger, None where there is none.
        Raises DriveError.
        """

    def command(self, speed_m_per_s: float) -> None:
        """Run at this speed, positive into the finger, from now on, within the soft limits.

        Never waits for the drive; the latest command wins. Commands before `start` or after a
        fault are passed over. From the first one on they must keep coming: after the scene's
        `watchdog` without any the tip withdraws, and that is a fault.
        """

    def press(self, force_n: float, taken_ns: int) -> None:
        """Take a reading of the film, which a withdrawal goes by as well."""

    def status(self) -> DriveStatus:
        """Return what the drive reported last, without a request."""

    def way_m(self, now_ns: int) -> float:
        """Return how far its commands lead until a time on the monotonic clock, from anywhere."""

    def withdraw(self, reason: str) -> None:
        """Take the tip off the finger from now on, and keep it there until `start`.

        Never waits for the drive. The reason is the fault, unless there is one.
        """

    def close(self) -> None:
        """Bring the drive to rest, disable it and let go of it. Never raises."""
