"""The `drive` table of kind "stepdir": telepulse's own board for a step and direction carrier."""

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from protocol.config.quantities import Nanoseconds
from pulse_drives.scene import DriveScene, Scale

# A velocity's frame, and the bits of a byte on the line.
VELOCITY_BITS = 13 * 10
# A velocity is valid for this share of the watchdog's time; then the board brakes.
VALID_SHARE = 0.5
# Velocities have this many units in a step a second.
PER_STEP_RATE = 256.0
# Keys of other kinds of drive.
OTHERS = frozenset(
    ("interface", "channel", "bitrate", "options", "velocity_scale", "homing_method")
)


class StepdirScene(DriveScene):
    """The `drive` table of kind "stepdir": the board of `firmware/telepulse_display`.

    port: a device or any URL that pyserial opens. home_switch: "normally_closed" opens at home, so
    that a broken wire reads as home. fault_pin: level of the carrier's fault output in a fault, if
    it is connected.
    """

    driver: ClassVar[str] = "pulse_drives.stepdir.drive:StepdirDrive"
    reads_film: ClassVar[bool] = True
    kind: Literal["stepdir"]
    port: Annotated[str, Field(min_length=1)]
    baud: Annotated[int, Field(ge=250_000, le=20_000_000)] = 500_000
    home_switch: Literal["normally_open", "normally_closed"] = "normally_open"
    fault_pin: Literal["none", "low", "high"] = "none"
    velocity_scale: Scale = PER_STEP_RATE
    watchdog_ns: Annotated[Nanoseconds, Field(ge=10_000_000, le=500_000_000)] = 50_000_000

    @model_validator(mode="after")
    def _has_no_key_of_another_kind(self) -> Self:
        fields = type(self).model_fields
        given = {fields[name].alias or name for name in self.model_fields_set}
        if others := given & OTHERS:
            raise ValueError(f'{min(others)} is not for kind = "stepdir"')
        return self

    @property
    def direction(self) -> int:
        """See `DriveScene.direction`: the board inverts its direction pin by itself."""
        return 1

    @property
    def validity_ms(self) -> int:
        """Validity of each velocity that is sent to the board."""
        return max(1, round(VALID_SHARE * self.watchdog_ns * 1e-6))

    @property
    def held_ns(self) -> int:
        """See `DriveScene.held_ns`."""
        return self.validity_ms * 1_000_000

    @property
    def exchange_s(self) -> float:
        """See `DriveScene.exchange_s`: the board's states come on a wire of their own."""
        return VELOCITY_BITS / self.baud
