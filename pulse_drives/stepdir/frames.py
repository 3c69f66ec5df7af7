"""Frames of the display board, both ways, as `firmware/PROTOCOL.md` states them. Pure.

Frames are those of `protocol.serial_frames`. A body is a format and the fields, in little-endian
order.
"""

import struct
from collections import Counter
from enum import IntEnum, IntFlag
from typing import NamedTuple

from protocol.serial_frames import CRC_BYTES, FrameReader, encode_frame

COUNTER_TURN = 1 << 32
SEQUENCE_TURN = 1 << 16
# A longer body is neither board's: with its CRC, one of the display board has at most 80 bytes.
MOST_BYTES = 80 - CRC_BYTES
# A sensor board's formats are 16 times the number of a sample's values, and more.
SENSOR_FORMATS = 16
_STATE = struct.Struct("<BIIhiiBBHHB")
_GREETING = struct.Struct("<BHBHIHB")
_ANSWER = struct.Struct("<BHBBB")
_HEAD = struct.Struct("<BH")
_VELOCITY = struct.Struct("<iH")
_HOME = struct.Struct("<IIIH")
_LIMITS = struct.Struct("<iiIIHHIIHB")


class Format(IntEnum):
    """First byte of a body."""

    STATE = 1
    GREETING = 2
    ANSWER = 3
    GREET = 8
    VELOCITY = 9
    HOME = 10
    LIMITS = 11
    ARM = 12
    DISARM = 13
    CLEAR = 14
    WITHDRAW = 15


class BoardMode(IntEnum):
    """State of the board's state machine: the protocol's `state`, one field of a `BoardState`."""

    DISARMED = 0
    ARMED = 1
    HOMING = 2
    READY = 3
    RUNNING = 4
    WITHDRAWING = 5
    WITHDRAWN = 6
    FAULT = 7

    @property
    def follows(self) -> bool:
        """True where the board takes velocities."""
        return self in (BoardMode.READY, BoardMode.RUNNING)


class TripCause(IntEnum):
    """Reason why the board has left the states in which it takes velocities."""

    NONE = 0
    SILENCE = 1
    FILM = 2
    FAULT_PIN = 3
    HOST = 4
    RESET = 5
    HOME_SWITCH = 6
    NO_HOME = 7
    STUCK_SWITCH = 8
    HOMING_TIMEOUT = 9
    PRESSED = 10


class CommandResult(IntEnum):
    """Result in the answer to a command."""

    DONE = 0
    WRONG_STATE = 1
    OUT_OF_BOUNDS = 2
    UNKNOWN = 3
    NO_LIMITS = 4
    FILM_OUTSIDE = 5


class StateFlag(IntFlag):
    """Flags of a state."""

    HOMED = 1
    HOME_CLOSED = 2
    AT_LOWEST = 4
    AT_HIGHEST = 8
    FAULT_PIN = 16
    FILM_OUTSIDE = 32
    HAS_LIMITS = 64
    ON = 128
    EXPIRED = 256


class LimitOption(IntFlag):
    """Options of the limits: levels of the board's pins, and the sign of its film."""

    INVERTED = 1
    NORMALLY_CLOSED = 2
    HAS_FAULT_PIN = 4
    FAULT_IS_HIGH = 8
    FILM_FALLS = 16


class BoardState(NamedTuple):
    """State of the board in one millisecond.

    film: the film's counts. position: in steps, from home where `StateFlag.HOMED`. velocity: in
    1/256 step/s. sequence: that of the last command taken. rejected: frames that the board could
    not read, modulo 256.
    """

    counter: int
    time_us: int
    film: int
    position: int
    velocity: int
    mode: BoardMode
    cause: TripCause
    flags: StateFlag
    sequence: int
    rejected: int


class BoardGreeting(NamedTuple):
    """Answer to `greet`; firmware: 256 times the major plus the minor version."""

    sequence: int
    protocol: int
    firmware: int
    tick_hz: int
    film_full_scale: int
    reset_cause: int
    name: str


class CommandAnswer(NamedTuple):
    """Answer to another command; field: number from 1 of the one that is out of bounds."""

    sequence: int
    command: Format
    result: CommandResult
    field: int


class BoardLimits(NamedTuple):
    """Fields of `limits`: in steps, steps a second, film counts and ms."""

    lowest: int
    highest: int
    acceleration: int
    highest_rate: int
    film_least: int
    film_most: int
    withdrawal: int
    withdrawal_rate: int
    watchdog_ms: int
    options: int


class HomeSearch(NamedTuple):
    """Fields of `home`: rate in steps/s, 0 where home is here; distances in steps."""

    rate: int
    distance: int
    opening: int
    timeout_ms: int


class BoardCommand(NamedTuple):
    """A command as the board receives it; fields: velocity and validity, search, limits, or ()."""

    format: Format
    sequence: int
    fields: tuple[int, ...]


BoardReport = BoardState | BoardGreeting | CommandAnswer
_FIELDS = {Format.VELOCITY: _VELOCITY, Format.HOME: _HOME, Format.LIMITS: _LIMITS}


def encode_command(command: Format, sequence: int, fields: tuple[int, ...] = ()) -> bytes:
    """Return the frame of a command. Raises struct.error for fields that do not fit."""
    packed = _FIELDS[command].pack(*fields) if fields else b""
    return encode_frame(_HEAD.pack(command, sequence) + packed)


def encode_report(report: BoardReport) -> bytes:
    """Return the frame of a board's state, greeting or answer."""
    match report:
        case BoardState():
            return encode_frame(_STATE.pack(Format.STATE, *report))
        case BoardGreeting():
            *numbers, name = report
            return encode_frame(_GREETING.pack(Format.GREETING, *numbers) + name.encode("ascii"))
        case _:
            return encode_frame(_ANSWER.pack(Format.ANSWER, *report))


def decode_report(body: bytes) -> BoardReport | None:
    """Return what a body from the board states; None for one that this host cannot read.

    A greeting of another protocol is read as far as this one knows it.
    """
    try:
        match body[0]:
            case Format.STATE:
                state = BoardState(*_STATE.unpack(body)[1:])
                return state._replace(
                    mode=BoardMode(state.mode),
                    cause=TripCause(state.cause),
                    flags=StateFlag(state.flags),
                )
            case Format.GREETING:
                name = body[_GREETING.size :].decode("ascii", "replace")
                _, sequence, protocol, firmware, *rest = _GREETING.unpack_from(body)
                tick_hz, full_scale, cause = rest
                return BoardGreeting(sequence, protocol, firmware, tick_hz, full_scale, cause, name)
            case Format.ANSWER:
                _, sequence, command, result, field = _ANSWER.unpack(body)
                return CommandAnswer(sequence, Format(command), CommandResult(result), field)
    except (struct.error, ValueError):
        pass
    return None


def decode_command(body: bytes) -> BoardCommand | None:
    """Return the command of a body from the host; None for an unknown one."""
    try:
        code, sequence = _HEAD.unpack_from(body)
        command, packed = Format(code), body[_HEAD.size :]
        fields = _FIELDS[command].unpack(packed) if command in _FIELDS else ()
    except (struct.error, ValueError):
        return None
    if command < Format.GREET or (packed and not fields):
        return None
    return BoardCommand(command, sequence, fields)


def board_reader() -> FrameReader:
    """Return a reader of frames of a display board, or of commands to one."""
    return FrameReader(MOST_BYTES, Counter())
