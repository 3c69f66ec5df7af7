"""Faults of a run: records that are latched, sent, stored and shown, and their remedies.

A fault is detected as a record and becomes text only where a person reads it. No code reads that
text. The JSON of a record has these fields under the same names, and a fault's remedy.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Self


class _Name(StrEnum):
    """Names of which a node of a later version may send others: these are read as unknown."""

    @classmethod
    def _missing_(cls, value: object) -> Self | None:
        return cls("unknown") if isinstance(value, str) and value != "unknown" else None


class Part(_Name):
    """The part of a node that a fault or a note is about."""

    DRIVE = "drive"
    BOARD = "board"
    FILM = "film"
    LOAD_CELL = "load cell"
    PROBE = "probe"
    SENSOR = "sensor"
    LOOP = "loop"
    LINK = "link"
    RECORDER = "recorder"
    UNKNOWN = "unknown"


class FaultKind(_Name):
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
    # Of a node of another version.
    UNKNOWN = "unknown"


START_AGAIN = "then start the node again"
#: Reasons to rest that are no faults.
RESTING = frozenset({FaultKind.NOT_STARTED, FaultKind.CLOSED, FaultKind.ENDED})

_LOOP = "this host stopped the loop: display-node --doctor names what helps"
_CONTRADICTION = "{part} and drive contradict each other: telepulse calibrate, telepulse bench"
_TOO_MUCH = "check the {part} (telepulse calibrate) and the drive's direction (telepulse bench)"
_POWER = "the tip may still press: switch the drive's power off, take the finger away"
_PORT = "check the drive's cable and port"
_BUS = "check the drive's cable, its CAN adapter and the bus"
_OTHER_DRIVE = "use a drive that fits the scene (docs/drives.md)"
#: Kind of a fault -> what a person is to do; {part} is the fault's.
REMEDIES = {
    FaultKind.LIBRARY_MISSING: "install the library that the cause names",
    FaultKind.NO_SUCH_PORT: _PORT,
    FaultKind.NOT_ALLOWED: "let this user open the drive's port: sudo usermod -aG dialout $USER",
    FaultKind.BUSY: "end the other program that uses the drive's port",
    FaultKind.NO_SUCH_INTERFACE: _BUS,
    FaultKind.NO_SUCH_BUS: _BUS,
    FaultKind.BUS_DOWN: _BUS,
    FaultKind.UNPLUGGED: _PORT,
    FaultKind.NO_ANSWER: "check the drive's power, cable, address and bit rate",
    FaultKind.GARBLED: "check the drive's cable, shield and bit rate",
    FaultKind.WRONG_DEVICE: "another device answers: check the drive's port and address",
    FaultKind.NO_POSITION: "the drive's answers come late: check its line, address and bit rate",
    FaultKind.REFUSED: "the drive rejects a setting of the scene: compare it with the drive's"
    " manual",
    FaultKind.NOT_CIA402: _OTHER_DRIVE,
    FaultKind.NO_SPEED_MODE: _OTHER_DRIVE,
    FaultKind.NO_WATCHDOG: _OTHER_DRIVE,
    FaultKind.NOT_HOMED: "check the home switch and `homing` in the scene",
    FaultKind.NOT_ENABLED: "check the drive's enable input and supply voltage",
    FaultKind.NOT_THERE: "check that the tip moves freely, then the motor's current and microsteps",
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
    FaultKind.NOT_A_NUMBER: "check the {part}'s sensor and its calibration in the scene",
    FaultKind.OVERFORCE: _TOO_MUCH,
    FaultKind.RISING: _TOO_MUCH,
    FaultKind.SILENT: "check the {part}'s sensor and its cable",
    FaultKind.LATE: "check the {part}'s sensor, its cable and the latency in [display.film]:"
    " telepulse bench measures it",
    FaultKind.TOO_LOW: _CONTRADICTION,
    FaultKind.OFF_FINGER: _CONTRADICTION,
    FaultKind.FROZEN: _CONTRADICTION,
    FaultKind.UNCONFIRMED: _POWER,
    FaultKind.TOWARDS_FINGER: _POWER,
    FaultKind.STILL_PRESSED: _POWER,
    FaultKind.UNKNOWN: "see docs/drives.md",
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
        return _line(self.contactor, self.part, self.cause)

    @property
    def identity(self) -> tuple[FaultKind, Part, str]:
        """Kind, part and contactor, which stay the same while the figures of the fault change."""
        return self.kind, self.part, self.contactor

    @property
    def advice(self) -> str:
        """Checks and actions before the node is started again."""
        advice = REMEDIES.get(self.kind, REMEDIES[FaultKind.UNKNOWN])
        return advice.format(part=self.part.value)

    @property
    def remedy(self) -> str:
        """Advice, and that the node is to be started again, in one line."""
        return f"{self.advice}; {START_AGAIN}"

    def to_dict(self) -> dict[str, Any]:
        """Return the record for JSON and msgpack."""
        return {
            "kind": self.kind.value,
            "part": self.part.value,
            "contactor": self.contactor,
            "cause": self.cause,
            "at_ns": self.at_ns,
            "remedy": self.remedy,
        }


@dataclass(frozen=True, slots=True)
class Note:
    """Something that is wrong with a sensor or the recorder, and latches nothing."""

    part: Part
    #: What is wrong, in one line.
    text: str
    #: Name of the contactor; empty where there is one alone, and for what is not of a contactor.
    contactor: str = ""

    def __str__(self) -> str:
        return _line(self.contactor, self.part, self.text)


def _line(contactor: str, part: Part, text: str) -> str:
    return ": ".join(filter(None, (contactor, "" if part is Part.UNKNOWN else part.value, text)))


def faults_of(summary: Mapping[str, Any]) -> list[Fault]:
    """Return the faults in a summary's JSON."""
    return [
        Fault(
            FaultKind(each["kind"]),
            Part(each["part"]),
            each["cause"],
            each["at_ns"],
            each["contactor"],
        )
        for each in summary.get("faults", ())
    ]


def notes_of(summary: Mapping[str, Any]) -> list[Note]:
    """Return the notes in a summary's JSON."""
    return [
        Note(Part(each["part"]), each["text"], each["contactor"])
        for each in summary.get("notes", ())
    ]


def texts_by_part(notes: Iterable[Note]) -> tuple[list[str], list[str], list[str]]:
    """Return the texts of notes on a display's films, on its sensing node, and on its recorder."""
    of_films, of_sensing_node, of_recorder = list[str](), list[str](), list[str]()
    for note in notes:
        if note.part is Part.FILM:
            of_films.append(f"{note.contactor}: {note.text}" if note.contactor else note.text)
        elif note.part is Part.RECORDER:
            of_recorder.append(note.text)
        else:
            of_sensing_node.append(note.text)
    return of_films, of_sensing_node, of_recorder


# The earlier form: faults and notes were texts in one list, and a note began with one of
# these.
_OLD_NOTES = {"film's sensor: ": Part.FILM, "sensing node: ": Part.SENSOR}


def records_of_texts(texts: Iterable[str]) -> tuple[list[Fault], list[Note]]:
    """Return the records of the texts that a summary of an earlier version has as its faults."""
    faults, notes = list[Fault](), list[Note]()
    for text in texts:
        prefix = next((prefix for prefix in _OLD_NOTES if text.startswith(prefix)), None)
        if prefix is None:
            faults.append(Fault(FaultKind.UNKNOWN, Part.UNKNOWN, text))
        else:
            notes.append(Note(_OLD_NOTES[prefix], text.removeprefix(prefix)))
    return faults, notes


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
