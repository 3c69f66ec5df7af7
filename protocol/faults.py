"""Faults of a run: records that are latched, sent, stored and shown, and their remedies.

A fault is detected as a record and becomes text only where a person reads it. No code reads that
text.
"""

from dataclasses import dataclass
from enum import StrEnum


class Part(StrEnum):
    """The part of a node that a fault or a note is about."""

    DRIVE = "drive"
    BOARD = "board"
    FILM = "film"
    LOAD_CELL = "load cell"
    PROBE = "probe"
    SENSOR = "sensor"
    LOOP = "loop"
    LINK = "link"


class FaultKind(StrEnum):
    """Kind of a fault, or of a drive's error; the value is its name in files and metrics."""

    # The line to a device.
    LIBRARY_MISSING = "library missing"
    NO_SUCH_PORT = "no such port"
    NOT_ALLOWED = "not allowed"
    BUSY = "busy"
    NO_SUCH_INTERFACE = "no such interface"
    NO_SUCH_BUS = "no such bus"
    BUS_DOWN = "bus down"
    UNPLUGGED = "unplugged"
    NO_ANSWER = "no answer"
    GARBLED = "garbled"
    WRONG_DEVICE = "wrong device"
    NO_POSITION = "no position"
    # A drive that does not start, or stops.
    REFUSED = "refused"
    NOT_CIA402 = "not CiA 402"
    NO_SPEED_MODE = "no speed mode"
    NO_WATCHDOG = "no watchdog"
    NOT_HOMED = "not homed"
    NOT_ENABLED = "not enabled"
    NOT_THERE = "not there"
    DRIVE_FAULT = "drive fault"
    LEFT_STATE = "left its state"
    WRONG_WAY = "wrong way"
    FOLLOWING_ERROR = "following error"
    # The loop.
    NO_COMMAND = "no command"
    OVERRUN = "loop overrun"
    INTERNAL = "internal error"
    # The film under the finger, or the load cell at the wrist.
    NOT_A_NUMBER = "not a number"
    OVERFORCE = "too much force"
    RISING = "force rises too fast"
    SILENT = "silent"
    LATE = "late"
    TOO_LOW = "reads too little"
    OFF_FINGER = "reads a press off the finger"
    FROZEN = "frozen"
    # The withdrawal.
    UNCONFIRMED = "withdrawal unconfirmed"
    TOWARDS_FINGER = "withdrawal went towards the finger"
    STILL_PRESSED = "still pressed"
    # Rest without a fault: before a start, after a close, at the end of a run.
    NOT_STARTED = "not started"
    CLOSED = "closed"
    ENDED = "ended"


_LOOP = "this host stopped the loop: display-node --doctor names what helps"
_FILM_AND_DRIVE = "film and drive contradict each other: telepulse calibrate, telepulse bench"
_POWER = "the tip may still press: switch the drive's power off, take the finger away"
_PORT = "check the drive's cable and port"
# Remedies of kinds that need one; what every fault needs is in `Fault.remedy`.
_REMEDIES = {
    FaultKind.UNPLUGGED: _PORT,
    FaultKind.NO_SUCH_PORT: _PORT,
    FaultKind.NOT_ALLOWED: _PORT,
    FaultKind.BUSY: _PORT,
    FaultKind.NO_SUCH_BUS: _PORT,
    FaultKind.BUS_DOWN: _PORT,
    FaultKind.NO_ANSWER: "check the drive's power, cable, address and bit rate",
    FaultKind.GARBLED: "check the drive's cable, shield and bit rate",
    FaultKind.WRONG_DEVICE: "another device answers: check the drive's port and address",
    FaultKind.NO_POSITION: "the drive's answers come late: check its line, address and bit rate",
    FaultKind.REFUSED: "the drive rejects a setting of the scene: compare it with the drive's"
    " manual",
    FaultKind.NOT_HOMED: "check the home switch and `homing` in the scene",
    FaultKind.NOT_ENABLED: "check the drive's enable input and supply voltage",
    FaultKind.DRIVE_FAULT: "the drive stopped itself: remove the cause, then switch its power off"
    " and on",
    FaultKind.LEFT_STATE: "another program or the drive itself has changed its state: end that"
    " program, check the drive's supply",
    FaultKind.WRONG_WAY: "check `inverted` in the scene and the motor's wires: telepulse bench",
    FaultKind.FOLLOWING_ERROR: "the tip does not move as commanded: check that it moves freely,"
    " then the motor's current and microsteps: telepulse bench",
    FaultKind.NO_COMMAND: _LOOP,
    FaultKind.OVERRUN: _LOOP,
    FaultKind.INTERNAL: "this is an error in a program, not of the bench: report it with this line",
    FaultKind.NOT_A_NUMBER: "check the film's sensor and its calibration in the scene",
    FaultKind.OVERFORCE: "check the film (telepulse calibrate) and the drive's direction"
    " (telepulse bench)",
    FaultKind.RISING: "check the film (telepulse calibrate) and the drive's direction"
    " (telepulse bench)",
    FaultKind.SILENT: "check the film's sensor and its cable",
    FaultKind.LATE: "check the film's sensor, its cable and the latency in [display.film]:"
    " telepulse bench measures it",
    FaultKind.TOO_LOW: _FILM_AND_DRIVE,
    FaultKind.OFF_FINGER: _FILM_AND_DRIVE,
    FaultKind.FROZEN: _FILM_AND_DRIVE,
    FaultKind.UNCONFIRMED: _POWER,
    FaultKind.TOWARDS_FINGER: _POWER,
    FaultKind.STILL_PRESSED: _POWER,
}


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault, or a drive's reason to rest.

    `str` gives the line that a person reads: "middle: drive: no answer for 52 ms".
    """

    kind: FaultKind
    part: Part
    #: What was observed, with its figures, in one line; not the remedy.
    cause: str
    #: Time of detection in ns on the monotonic clock of the node's host; 0 if unknown.
    at_ns: int = 0
    #: Name of the contactor; empty where there is one alone, and for what concerns all.
    contactor: str = ""

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.contactor, self.part.value, self.cause)))

    @property
    def remedy(self) -> str:
        """What a person is to do, in one line."""
        remedy = _REMEDIES.get(self.kind, "see docs/drives.md")
        return f"{remedy}; then start the node again"


@dataclass(frozen=True, slots=True)
class Note:
    """Something that is wrong with a sensor, and latches nothing."""

    part: Part
    #: What is wrong, in one line.
    text: str
    #: Name of the contactor; empty where there is one alone, and for the sensing node's sensor.
    contactor: str = ""

    def __str__(self) -> str:
        return ": ".join(filter(None, (self.contactor, self.part.value, self.text)))


def internal_fault(part: Part, thread: str, error: BaseException, at_ns: int) -> Fault:
    """Return the fault of an exception that no code expects, with its place in the program."""
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    place = ""
    if trace is not None:
        code = trace.tb_frame.f_code
        place = f" in {code.co_filename.rpartition('/')[2]}:{trace.tb_lineno}, {code.co_name}"
    name = type(error).__qualname__
    if type(error).__module__ != "builtins":
        name = f"{type(error).__module__}.{name}"
    words = f"{name}: {error}" if str(error) else name
    return Fault(FaultKind.INTERNAL, part, f"{words}{place} (thread {thread})", at_ns)
