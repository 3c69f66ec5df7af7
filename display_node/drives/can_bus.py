"""Opening the CAN bus that a scene names.

What python-can meets where it reads: noise from a CAN adapter, or a bus that is gone.
"""

import time
from collections import Counter
from typing import TYPE_CHECKING, Any

from display_node.drives.scene import DriveScene
from protocol.errors import DriveError

if TYPE_CHECKING:
    import can

# A bus that is gone fails at every look at it.
PAUSE_S = 0.05


def is_noise(error: Exception) -> bool:
    """Whether a bus could make no frame of what came, rather than being gone."""
    # Some interfaces wrap what they met in an error of python-can.
    met = error.__cause__ or error
    return isinstance(met, ValueError | IndexError) and not isinstance(met, OSError)


def pass_over(bus: Any) -> None:
    """Forget the line that noise has spoilt: an slcan interface keeps it, and fails at it again."""
    flush = getattr(bus, "flush", None)
    if flush is not None:
        flush()


class BusErrors:
    """A listener of a canopen network, whose thread would print a traceback and end without it.

    What is "garbled" is counted and passed over.

    lost: why the bus cannot be read any more; None while it can.
    """

    def __init__(self, network: Any, counts: Counter[str]) -> None:
        self._network = network
        self._counts = counts
        self.lost: Exception | None = None

    def __call__(self, message: object) -> None:
        """Frames are the network's business."""

    def on_error(self, error: Exception) -> None:
        """Reading has failed."""
        if not is_noise(error):
            self.lost = error
            time.sleep(PAUSE_S)
            return
        pass_over(self._network.bus)
        self._network.notifier.exception = None
        self._counts["garbled"] += 1


def open_bus(scene: DriveScene) -> "can.BusABC":
    """The bus, by python-can. Raises DriveError."""
    import can

    settings: dict[str, Any] = {
        "interface": scene.interface,
        "channel": scene.channel,
        "bitrate": round(scene.bitrate_bit_per_s),
        **scene.options,
    }
    try:
        return can.Bus(**settings)
    # Interfaces come from many makers, and each fails in its own way.
    except Exception as error:
        raise DriveError(
            "unplugged",
            f"CAN bus {scene.interface} {scene.channel} cannot be opened: {error}",
        ) from None
