"""The interface of a real drive to the force loop, whatever bus it is on."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from display_node.drives.withdrawal import WithdrawalOutcome


@dataclass(frozen=True, slots=True)
class DriveStatus:
    """The last report of a drive.

    Attributes
    ----------
    position_m
        Tip position in m from first touch, positive into the finger.
    fault
        Fault that ended the following of commands until `Drive.start` is called again, or None.
    moving
        The drive reports a speed.
    received_ns
        Time of the position on the monotonic clock; 0 before any.
    withdrawal
        State of the withdrawal since the fault; None without a fault, and where the drive was not
        moving by commands.
    answered_ns
        Time of the drive's last answer of any kind.
    held_back
        The last command was slowed before the far end of the travel.
    """

    position_m: float
    speed_m_per_s: float
    fault: str | None
    moving: bool
    received_ns: int
    withdrawal: WithdrawalOutcome | None = None
    answered_ns: int = 0
    held_back: bool = False


def no_film() -> None:
    """Return no reading, where no film lies under the finger."""


class Drive(Protocol):
    """A stepper's drive that takes speeds.

    Attributes
    ----------
    counts
        Errors on the bus that the next message made good, by name.
    """

    counts: Counter[str]

    def start(self, force_n: Callable[[], float | None] = no_film) -> None:
        """Connect, check, enable, home, verify the direction and go to first touch; blocks.

        Parameters
        ----------
        force_n
            Returns the newest reading of the film in N, None where there is none.

        Raises
        ------
        DriveError
            Where any of it fails; the drive is closed then.
        """

    def command(self, speed_m_per_s: float) -> None:
        """Run at this speed, positive into the finger, from now on, within the soft limits.

        Never waits for the drive; the latest command wins. Commands before `start` or after a
        fault are ignored. From the first one on they must keep coming: the scene's `watchdog`
        without any is a fault, and the tip withdraws.
        """

    def report_film(self, force_n: float, taken_ns: int) -> None:
        """Take a reading of the film in N, by which a withdrawal is judged as well."""

    def status(self) -> DriveStatus:
        """Return what the drive reported last, without a request."""

    def travel_m(self, now_ns: int) -> float:
        """Return the travel in m that was commanded until a time, from any origin."""

    def withdraw(self, reason: str) -> None:
        """Take the tip off the finger from now on, and keep it there until `start`.

        Never waits for the drive. The reason becomes the fault, unless there is one.
        """

    def close(self) -> None:
        """Bring the drive to rest, disable and disconnect it. Never raises."""
