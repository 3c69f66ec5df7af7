"""Opening the CAN bus that a scene names."""

from typing import TYPE_CHECKING, Any

from display_node.drives.scene import DriveScene
from protocol.errors import DriveError

if TYPE_CHECKING:
    import can


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
