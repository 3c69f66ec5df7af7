"""The tables of a real drive: its motor and screw, and its bus, units and homing."""

import errno
import math
import os
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import Field, model_validator

from protocol.config.kinds import KindGroup, KindTable, OfKind
from protocol.config.quantities import (
    BitsPerSecond,
    Metres,
    MetresPerSecond,
    MetresPerSecond2,
    Nanoseconds,
    Radians,
)
from protocol.config.scene import Section
from protocol.errors import DriveError
from protocol.faults import FaultKind

if TYPE_CHECKING:
    import can
    import serial

# A TMCL datagram has 9 bytes, each with a start and a stop bit; every request has its reply.
TMCL_BITS = 9 * 10
TMCL_CAN_BYTES = 7
# One cycle: RPDO (control word, target velocity), SYNC, TPDOs (status, mode and position; speed
# and error code).
CIA402_BYTES = (6, 0, 7, 6)
Scale = Annotated[float, Field(gt=0, le=1e9)]


class MotorScene(Section):
    """The keys of a stepper motor and its screw."""

    step_angle_rad: Annotated[Radians, Field(gt=0)] = math.radians(1.8)
    microsteps: Annotated[int, Field(ge=1, le=256)] = 16
    lead_m: Annotated[Metres, Field(gt=0, le=0.1)] = 2e-3
    max_speed_m_per_s: Annotated[MetresPerSecond, Field(gt=0)] = 0.4
    max_acceleration_m_per_s2: Annotated[MetresPerSecond2, Field(gt=0)] = 20.0
    stroke_m: Annotated[Metres, Field(gt=0)] = 0.1

    @property
    def step_m(self) -> float:
        """Travel of one microstep."""
        return self.lead_m * self.step_angle_rad / (2 * math.pi) / self.microsteps


class DriveScene(KindTable):
    """Keys of all kinds of drive.

    interface, channel, bitrate: a CAN bus in python-can's terms. options: further settings of the
    interface. velocity_scale: the drive's velocity units in one microstep a second. inverted: the
    drive's positive direction leads away from the finger.

    homing: "switch" moves away from the finger to a limit switch; "none" takes the present position
    as home. homing_method: number of a homing method of the drive, which replaces `homing`. touch:
    distance from home to first touch of the finger. furthest: greatest depth beyond that, by
    default where a display's contact law gives the force limit, or the probe's travel.

    period: greatest time between two commands. watchdog: time without a command after which the
    drive stops by itself, and without an answer after which it has failed.
    """

    # Its class, a `Drive`, as "module:class"; it is made of this table and an `Axis`.
    driver: ClassVar[str]
    # Whether [display.feedback] can be of kind "drive".
    reads_film: ClassVar[bool] = False
    interface: str | None = None
    channel: str | None = None
    bitrate_bit_per_s: Annotated[BitsPerSecond, Field(ge=10_000, le=8_000_000)] = 1e6
    options: dict[str, str | int | float | bool] = Field(default_factory=dict)
    velocity_scale: Scale = 1.0
    inverted: bool = False
    homing: Literal["switch", "none"] = "switch"
    homing_method: Annotated[int, Field(ge=-128, le=127)] | None = None
    homing_speed_m_per_s: Annotated[MetresPerSecond, Field(gt=0, le=0.1)] = 5e-3
    touch_m: Annotated[Metres, Field(ge=0, le=0.1)] = 2e-3
    furthest_m: Annotated[Metres, Field(gt=0, le=0.1)] | None = None
    period_ns: Annotated[Nanoseconds, Field(ge=500_000, le=100_000_000)] = 2_000_000
    watchdog_ns: Annotated[Nanoseconds, Field(ge=10_000_000, le=1_000_000_000)] = 50_000_000

    @model_validator(mode="after")
    def _repeats_in_time(self) -> "DriveScene":
        if 4 * self.period_ns > self.watchdog_ns:
            raise ValueError("period must be at most a quarter of watchdog")
        if (self.interface is None) != (self.channel is None):
            raise ValueError("a CAN bus needs both interface and channel")
        return self

    @property
    def units_per_step(self) -> float:
        """The drive's position units in one microstep."""
        return 1.0

    @property
    def direction(self) -> int:
        """1 where the drive's positive direction leads into the finger, −1 where it leads away."""
        return -1 if self.inverted else 1

    @property
    def held_ns(self) -> int:
        """Time for which the drive keeps a velocity that is not sent again; then it brakes."""
        return self.watchdog_ns

    @property
    def exchange_s(self) -> float | None:
        """Time in s for which one command and its answer occupy the line; None if unknown."""
        return None


class TmclScene(DriveScene):
    """The `drive` table of kind "tmcl": a TMCL module on a serial port or on CAN.

    port: a device or any URL that pyserial opens. module, host: addresses on the line.
    acceleration_scale: the module's acceleration units in one microstep a second squared.
    """

    driver: ClassVar[str] = "pulse_drives.tmcl.drive:TmclDrive"
    kind: Literal["tmcl"]
    port: str | None = None
    baud: Annotated[int, Field(ge=1200, le=20_000_000)] = 115_200
    module: Annotated[int, Field(ge=1, le=255)] = 1
    host: Annotated[int, Field(ge=1, le=255)] = 2
    motor: Annotated[int, Field(ge=0, le=5)] = 0
    acceleration_scale: Scale = 1.0
    reply_timeout_ns: Annotated[Nanoseconds, Field(ge=1_000_000, le=200_000_000)] = 10_000_000

    @model_validator(mode="after")
    def _one_way_to_reach_it(self) -> "TmclScene":
        if (self.port is None) == (self.channel is None):
            raise ValueError("give either port (a serial line) or interface and channel (CAN)")
        if 4 * self.reply_timeout_ns > self.watchdog_ns:
            raise ValueError("reply_timeout must be at most a quarter of watchdog")
        return self

    @property
    def exchange_s(self) -> float:
        """See `DriveScene.exchange_s`."""
        if self.port is None:
            return 2 * can_frame_bits(TMCL_CAN_BYTES) / self.bitrate_bit_per_s
        return 2 * TMCL_BITS / self.baud


class Cia402Scene(DriveScene):
    """The `drive` table of kind "cia402": a CANopen drive of profile CiA 402.

    node: the drive's node id. host: node id of this side's heartbeat. mode: cyclic synchronous
    velocity, profile velocity, or "auto", the first of them that the drive supports.
    position_scale: the drive's position units in one microstep.
    """

    driver: ClassVar[str] = "pulse_drives.cia402.drive:Cia402Drive"
    kind: Literal["cia402"]
    interface: str
    channel: str
    node: Annotated[int, Field(ge=1, le=126)] = 1
    host: Annotated[int, Field(ge=1, le=127)] = 127
    mode: Literal["auto", "cyclic", "profile"] = "auto"
    position_scale: Scale = 1.0

    @property
    def units_per_step(self) -> float:
        """See `DriveScene.units_per_step`."""
        return self.position_scale

    @property
    def exchange_s(self) -> float:
        """See `DriveScene.exchange_s`."""
        return sum(map(can_frame_bits, CIA402_BYTES)) / self.bitrate_bit_per_s


DRIVES = KindGroup(
    "telepulse.drives",
    "drive",
    DriveScene,
    {
        "tmcl": "pulse_drives.scene:TmclScene",
        "cia402": "pulse_drives.scene:Cia402Scene",
        "stepdir": "pulse_drives.stepdir.scene:StepdirScene",
    },
)
DriveTable = Annotated[DriveScene, OfKind(DRIVES)]


def can_frame_bits(data_bytes: int) -> int:
    """Return the most bits of a CAN frame with an 11-bit identifier (ISO 11898-1)."""
    # Frame and pause, the data, and a stuffed bit after every 4 bits of the stuffed part.
    return 47 + 8 * data_bytes + (34 + 8 * data_bytes - 1) // 4


_KINDS = {
    errno.ENOENT: FaultKind.NO_SUCH_PORT,
    errno.EACCES: FaultKind.NOT_ALLOWED,
    errno.EPERM: FaultKind.NOT_ALLOWED,
    errno.EBUSY: FaultKind.BUSY,
    # Of a port that another program has locked.
    errno.EAGAIN: FaultKind.BUSY,
    errno.ENODEV: FaultKind.NO_SUCH_BUS,
    errno.ENETDOWN: FaultKind.BUS_DOWN,
}


def _error_number(error: BaseException) -> int | None:
    """Return the system's number of an error; None where it has none."""
    # A termios.error has its number as an argument alone, one of python-can as error_code.
    numbers = (getattr(error, "errno", None), getattr(error, "error_code", None), *error.args[:1])
    return next((number for number in numbers if isinstance(number, int)), None)


def line_fault(error: BaseException) -> FaultKind:
    """Return the kind of fault for which a line cannot be opened."""
    number = _error_number(error)
    cause = error.__cause__ or error.__context__
    if number is None and cause is not None:
        return line_fault(cause)
    return _KINDS.get(number or 0, FaultKind.UNPLUGGED)


def open_port(
    name: str, baud: int, read_within_s: float, write_within_s: float
) -> "serial.SerialBase":
    """Open a serial port, or any URL that pyserial opens. Raises DriveError."""
    import serial

    try:
        # No second program may command the same drive.
        port: serial.SerialBase = serial.serial_for_url(
            name, baud, timeout=read_within_s, write_timeout=write_within_s, exclusive=True
        )
    # pyserial passes on errors of many kinds, such as termios.error.
    except Exception as error:
        number = _error_number(error)
        reason = os.strerror(number) if number else error
        raise DriveError(line_fault(error), f"{name} cannot be opened: {reason}") from None
    return port


def open_bus(scene: DriveScene) -> "can.BusABC":
    """Open the CAN bus of a scene by python-can. Raises DriveError."""
    import can

    try:
        return can.Bus(
            interface=scene.interface,
            channel=scene.channel,
            bitrate=round(scene.bitrate_bit_per_s),
            **scene.options,  # type: ignore[arg-type]
        )
    # Interfaces come from many makers, and raise errors of many kinds.
    except Exception as error:
        unknown = isinstance(error, can.CanInterfaceNotImplementedError)
        kind = FaultKind.NO_SUCH_INTERFACE if unknown else line_fault(error)
        raise DriveError(
            kind, f"CAN bus {scene.interface} {scene.channel} cannot be opened: {error}"
        ) from None


def is_noise(error: Exception) -> bool:
    """Return whether an error means that a frame could not be decoded, and not a lost bus."""
    # Some interfaces wrap the cause in an error of python-can.
    cause = error.__cause__ or error
    return isinstance(cause, ValueError | IndexError) and not isinstance(cause, OSError)


def discard_spoilt_line(bus: Any) -> None:
    """Discard a corrupted line, which an slcan interface would keep and fail at again."""
    if hasattr(bus, "flush"):
        bus.flush()
