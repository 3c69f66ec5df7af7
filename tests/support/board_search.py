"""Searches for a script after which the finger's board does what `firmware/PROTOCOL.md` excludes.

A script is commands, inputs and silences. `board_search.cpp` plays it on the sketch as compiled for
this machine, and has the rules; this module compiles it, also with changed sources, and shortens
and prints the script that breaks a rule.
"""

import ctypes
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple, Self

from pulse_drives.stepdir.frames import BoardLimits, Format, HomeSearch
from telepulse.emulators import sketch

SOURCE = Path(__file__).with_name("board_search.cpp")
LONGEST_SCRIPT = 64


def _enumeration(name: str) -> dict[int, str]:
    """Return the members of an enumeration of board_search.cpp by their numbers."""
    (body,) = re.findall(rf"enum {name} : int32_t {{(.*?)}};", SOURCE.read_text("utf-8"), re.DOTALL)
    members, number = {}, 0
    for member in body.replace("\n", " ").split(","):
        key, _, given = member.strip().partition(" = ")
        number = int(given) if given else number
        members[number] = key
        number += 1
    return members


_RULES = _enumeration("Rule")
_KINDS = _enumeration("Kind")
RULES = frozenset(_RULES.values()) - {"NO_RULE"}


class Setting(ctypes.Structure):
    """Place of the tip at power-up and of home, in mm from first touch, and the wiring."""

    _fields_ = (
        *((name, ctypes.c_double) for name in ("start_mm", "touch_mm")),
        *(
            (name, ctypes.c_int32)
            for name in ("inverted", "normally_closed", "fault_pin", "film_falls")
        ),
    )


class Action(ctypes.Structure):
    """A command, an input or a silence, and the time until the next."""

    _fields_ = (
        ("kind", ctypes.c_int32),
        ("wait_ms", ctypes.c_int32),
        ("values", ctypes.c_int64 * 10),
    )

    def __str__(self) -> str:
        return f"{_words(self.kind, list(self.values))}; {self.wait_ms} ms"


class _Finding(ctypes.Structure):
    _fields_ = (
        ("rule", ctypes.c_int32),
        ("actions", ctypes.c_int32),
        ("board_ms", ctypes.c_int64),
        ("setting", Setting),
        ("text", ctypes.c_char * 200),
        ("script", Action * LONGEST_SCRIPT),
    )


class Finding(NamedTuple):
    """A script that breaks a rule of `RULES`, found after a time of the board."""

    rule: str
    text: str
    setting: Setting
    script: list[Action]
    board_ms: int

    def __str__(self) -> str:
        names = [name for name, _ in Setting._fields_]
        setting = ", ".join(f"{name} {getattr(self.setting, name):g}" for name in names)
        lines = (f"    {number}. {action}" for number, action in enumerate(self.script, 1))
        return "\n".join((f"{self.rule}: {self.text}", f"    {setting}", *lines))


class BoardSearch:
    """A compiled search. Each has one board, and may be used from one thread at a time."""

    def __init__(self, library: Path) -> None:
        self._library = ctypes.CDLL(str(library))
        for name in ("search_play", "search_at_random", "search_all"):
            getattr(self._library, name).restype = ctypes.c_int64

    @classmethod
    def compile(cls, folder: Path, *changes: tuple[str, str]) -> Self:
        """Compile it in a folder, with changes of the sketch's text. Raises ProcessError."""
        return cls(_compile(folder, *changes))

    def play(self, setting: Setting, script: Sequence[Action]) -> Finding | None:
        """Play a script, and the silence after it; return the rule that it breaks."""
        found = _Finding()
        actions = (Action * len(script))(*script)
        self._library.search_play(ctypes.byref(setting), actions, len(script), ctypes.byref(found))
        return _finding(found)

    def at_random(self, seed: int, board_ms: int) -> tuple[int, Finding | None]:
        """Play random scripts for a time of the board; return the time, and what was found."""
        found = _Finding()
        passed_ms: int = self._library.search_at_random(
            ctypes.c_uint64(seed), ctypes.c_int64(board_ms), ctypes.byref(found)
        )
        return passed_ms, self._shortened(found)

    def all_sequences(
        self, depth: int, reversed_motor: bool, part: int = 0, parts: int = 1
    ) -> tuple[int, int, Finding | None]:
        """Play all sequences up to a depth, in each state of the board, or a part of them.

        Returns the time of the board, the number of sequences, and what was found.
        """
        found, sequences = _Finding(), ctypes.c_int64()
        passed_ms: int = self._library.search_all(
            *(depth, part, parts, int(reversed_motor)),
            *(ctypes.byref(sequences), ctypes.byref(found)),
        )
        return passed_ms, sequences.value, self._shortened(found)

    def _shortened(self, found: _Finding) -> Finding | None:
        """Return a finding without the actions and times that it does not need."""
        finding = _finding(found)
        if finding is None:
            return None
        script, best = finding.script, finding
        size = len(script)
        while size:
            at, is_shorter = 0, False
            while at < len(script):
                without = script[:at] + script[at + size :]
                if (again := self._again(finding, without)) is not None:
                    script, best, is_shorter = without, again, True
                else:
                    at += size
            if not is_shorter:
                size //= 2
        for at, action in enumerate(script):
            sooner = [*script[:at], Action(action.kind, 1, action.values), *script[at + 1 :]]
            if (again := self._again(finding, sooner)) is not None:
                script, best = sooner, again
        return best._replace(board_ms=finding.board_ms)

    def _again(self, finding: Finding, script: list[Action]) -> Finding | None:
        again = self.play(finding.setting, script)
        return again if again is not None and again.rule == finding.rule else None


def copies(folder: Path, count: int) -> list[BoardSearch]:
    """Return searches for as many threads: copies of one library, each with a board of its own."""
    library = _compile(folder)
    paths = [folder / f"search-{number}.so" for number in range(count)]
    return [BoardSearch(Path(shutil.copyfile(library, path))) for path in paths]


def _compile(folder: Path, *changes: tuple[str, str]) -> Path:
    """Return the library; without changes it is kept in the user's cache."""
    firmware = folder / "firmware"
    shutil.copytree(sketch.FIRMWARE, firmware)
    host = firmware / "host"
    (host / "host.cpp").rename(host / "world.cpp")
    shutil.copyfile(SOURCE, host / "host.cpp")
    for old, new in changes:
        _replace(firmware / "telepulse_display", old, new)
    return sketch.compiled(firmware, folder if changes else None)


def _replace(folder: Path, old: str, new: str) -> None:
    """Replace a text that the sources of a folder contain once."""
    holders = [path for path in sorted(folder.iterdir()) if old in path.read_text("utf-8")]
    assert len(holders) == 1, f"{old!r} is in {len(holders)} files"
    text = holders[0].read_text("utf-8")
    assert text.count(old) == 1, f"{old!r} is there {text.count(old)} times"
    holders[0].write_text(text.replace(old, new), encoding="utf-8")


def _finding(found: _Finding) -> Finding | None:
    if not found.rule:
        return None
    # Copies, as each search has one place for its script.
    script = [Action.from_buffer_copy(found.script[at]) for at in range(found.actions)]
    setting = Setting.from_buffer_copy(found.setting)
    return Finding(_RULES[found.rule], found.text.decode(), setting, script, found.board_ms)


def _words(kind: int, values: list[int]) -> str:
    first, second, third, *_ = values
    match _KINDS.get(kind):
        case "RAW":
            return f"a frame of format {first} with {second} bytes"
        case "GARBAGE":
            return f"garbage {first}"
        case "STREAM":
            return f"each {third} ms velocity {first / 256:g} steps/s for {second} ms"
        case "FILM_IS":
            return f"the film goes to 2 x {first} in {second} ms" if first >= 0 else "film ok"
        case "SWITCH_IS":
            return f"the switch is {('ok', 'stuck open', 'stuck closed')[first + 1]}"
        case "FAULT_IS":
            return f"the fault pin is {('ok', 'active')[first]}"
        case "RESET_BY":
            torn = ", the kept position is torn" if third else ""
            return f"reset by cause {first}, bootloader {second} ms{torn}"
        case "HANG":
            return "the program hangs"
        case "CLOCK":
            return f"the clocks are at {first} us, {second} ms"
        case "SLIP":
            return f"the tip slips by {first} steps"
        case "WAIT":
            return "silence"
    command = Format(kind)
    names: tuple[str, ...] = {
        Format.VELOCITY: ("velocity", "validity_ms"),
        Format.HOME: HomeSearch._fields,
        Format.LIMITS: BoardLimits._fields,
    }.get(command, ())
    pairs = zip(names, values, strict=False)
    return " ".join([command.name.lower(), *(f"{name}={value}" for name, value in pairs)])
