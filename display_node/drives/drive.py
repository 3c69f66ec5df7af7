"""What every drive does for the force loop, whatever it is reached by."""

from collections import Counter
from dataclasses import dataclass
from typing import Protocol

from display_node.step_rate import StepCommand


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """What a drive said last.

    position_m: of the tip from first touch, positive into the finger. fault: what keeps it at
    rest until `Drive.start` is called again, or None. heard_ns: when the position was heard, on
    the monotonic clock; 0 before any was. held_back: the last command was slowed before the far
    end of the travel.
    """

    position_m: float
    speed_m_per_s: float
    fault: str | None
    moving: bool
    heard_ns: int
    held_back: bool = False


class Drive(Protocol):
    """A stepper's drive that takes step rates.

    counts: what went wrong on the way to it and was made good, by name.
    """

    counts: Counter[str]

    def start(self) -> None:
        """Connect, check, enable, home and come to first touch; blocks. Raises DriveError."""

    def command(self, command: StepCommand) -> None:
        """Run at this step rate from now on, within the soft limits.

        Never waits for the drive; the latest command wins. Commands before `start` or after a
        fault are passed over. From the first one on they must keep coming: after the scene's
        `watchdog` without any the drive comes to rest, and that is a fault.
        """

    def status(self) -> DriveStatus:
        """What the drive said last, without asking it."""

    def way_m(self, now_ns: int) -> float:
        """How far its commands lead until a time on the monotonic clock, from anywhere."""

    def stop(self) -> None:
        """Come to rest as fast as the drive can, and stay there until `start`."""

    def close(self) -> None:
        """Bring the drive to rest, disable it and let go of it. Never raises."""
