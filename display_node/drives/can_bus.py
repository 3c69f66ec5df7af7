"""The CAN bus of a scene: opening it, and errors of reading: noise, or a bus that is gone."""

import time
from collections import Counter
from typing import TYPE_CHECKING, Any

from display_node.drives.scene import DriveScene
from protocol.errors import DriveError

if TYPE_CHECKING:
    import can

# A bus that is gone fails at every read.
PAUSE_S = 0.05


def is_noise(error: Exception) -> bool:
    """Return whether a bus could not decode a frame, rather than being gone."""
    # Some interfaces wrap the cause in an error of python-can.
    cause = error.__cause__ or error
    return isinstance(cause, ValueError | IndexError) and not isinstance(cause, OSError)


def discard_spoilt_line(bus: Any) -> None:
    """Discard a line that noise has spoilt: an slcan interface keeps it, and fails at it again."""
    flush = getattr(bus, "flush", None)
    if flush is not None:
        flush()


class BusErrors:
    """Error listener of a canopen network, whose thread would end with a traceback without it.

    A "garbled" frame is counted and ignored.

    Attributes
    ----------
    lost
        Error by which the bus cannot be read any more; None while it can.
    """

    def __init__(self, network: Any, counts: Counter[str]) -> None:
        self._network = network
        self._counts = counts
        self.lost: Exception | None = None

    def __call__(self, message: object) -> None:
        """Ignore a frame: the network handles it."""

    def on_error(self, error: Exception) -> None:
        """Handle an error of reading."""
        if not is_noise(error):
            self.lost = error
            time.sleep(PAUSE_S)
            return
        discard_spoilt_line(self._network.bus)
        self._network.notifier.exception = None
        self._counts["garbled"] += 1


def open_bus(scene: DriveScene) -> "can.BusABC":
    """Open the bus by python-can. Raises DriveError."""
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
