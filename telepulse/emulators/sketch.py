"""The finger's sketch, compiled for this machine once and loaded: boards without a chip.

`firmware/host/host.h` has the library's functions. Time passes in `Sketch.run` alone.
"""

import ctypes
import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import RLock
from typing import Any

from protocol.errors import ProcessError

_HERE = Path(__file__).parents[1]
# In an installed package (pyproject.toml), and in a copy of the repository.
FIRMWARE = next(
    (each for each in (_HERE / "firmware", _HERE.parent / "firmware") if each.is_dir()),
    _HERE / "firmware",
)
COMPILERS = ("c++", "g++", "clang++")
# Overflow wraps and products are rounded as on the AVR.
OPTIONS = (
    "-std=c++20",
    "-O2",
    "-fPIC",
    "-shared",
    "-fvisibility=hidden",
    "-fwrapv",
    "-ffp-contract=off",
    "-DTELEPULSE_HOST",
)
# In this order: begin.cpp.
SOURCES = ("begin.cpp", "host.cpp", "end.cpp")
NO_COMPILER = (
    "the emulated board of the finger is its sketch, which needs a C++ compiler: install g++"
    " (Debian: apt install g++; macOS: xcode-select --install)"
)
NO_WINDOWS = "the emulated board of the finger runs on Linux and macOS, not on Windows"
TAKEN_BYTES = 4096
# Until this process ends.
_own_folder: TemporaryDirectory[str] | None = None


def missing() -> str | None:
    """Return why this machine cannot compile the sketch, with the remedy; None where it can."""
    if sys.platform == "win32":
        return NO_WINDOWS
    return None if _compiler() else NO_COMPILER


def compiled(firmware: Path = FIRMWARE, into: Path | None = None) -> Path:
    """Return the library of a folder of sources, compiled where that was not done before.

    into: folder of the library, by default the user's cache. Several processes may compile it at
    once. Raises ProcessError without a compiler, or with the compiler's complaint.
    """
    if (reason := missing()) is not None:
        raise ProcessError(reason)
    command = [str(_compiler()), *OPTIONS, f"-I{firmware / 'host'}"]
    library = (into or _cache_folder()) / f"board-{_digest(firmware)}.so"
    if library.is_file():
        return library
    with TemporaryDirectory(dir=library.parent) as folder:
        made = Path(folder) / library.name
        command += [str(firmware / "host" / name) for name in SOURCES]
        run_compiler(Path(folder), *command, "-o", str(made))
        made.replace(library)
    return library


def run_compiler(folder: Path, *command: str) -> None:
    """Run a compiler in a folder. Raises ProcessError with its complaint."""
    made = subprocess.run(command, cwd=folder, capture_output=True, encoding="utf-8", check=False)
    if made.returncode:
        raise ProcessError(f"{command[0]} failed: {made.stderr.strip()}")


class Sketch:
    """A board with its motor, screw, rubber and film, without power until `power_up`.

    Boards that share a library may be used from any threads.

    Parameters
    ----------
    library
        That of `compiled`, by default of telepulse's own sources.
    settings
        Those of `host_set` in host.h.

    Raises ProcessError where the sketch cannot be compiled.
    """

    def __init__(self, library: Path | None = None, /, **settings: float) -> None:
        self._library = _Library.load(library or compiled())
        self.state = ctypes.create_string_buffer(self._library.state_bytes)
        self._taken = ctypes.create_string_buffer(TAKEN_BYTES)
        self._library.make(self)
        self.set(**settings)

    def set(self, **settings: float) -> None:
        """Change settings, or begin and end faults. Raises KeyError where there is none."""
        for name, value in settings.items():
            if not self._call("host_set", name.encode(), value):
                raise KeyError(name)

    def power_up(self) -> None:
        """Start the sketch; its memory is void."""
        self._call("host_power_up")

    def reset(self, cause: int, bootloader_ms: int = 0) -> None:
        """Reset it by a cause, as the greeting's `reset_cause` numbers them."""
        self._call("host_reset", cause, bootloader_ms)

    def set_clock(self, us: int, ms: int) -> None:
        """Set the counters of microseconds and milliseconds, to be near their end."""
        self._call("host_set_clock", us, ms)

    def run(self, ms: int) -> None:
        """Let time pass."""
        self._call("host_run", ms)

    def feed(self, data: bytes) -> int:
        """Send bytes to the board; return how many there was room for."""
        count: int = self._call("host_feed", data, len(data))
        return count

    def take(self) -> bytes:
        """Return the bytes that the board has sent since the last call."""
        count = self._call("host_take", self._taken, TAKEN_BYTES)
        return self._taken.raw[:count]

    def film(self, first: int, second: int) -> None:
        """Set the film's counts in the halves of each millisecond; below 0: by its amplifier."""
        self._call("host_film", first, second)

    def look(self) -> Any:
        """Return the present `host_view` of host.h."""
        view = self._library.view_type()
        self._call("host_look", ctypes.byref(view))
        return view

    def save(self) -> bytes:
        """Return the whole state, for `restore` in this process."""
        self._call("host_save", self.state)
        return self.state.raw

    def restore(self, state: bytes) -> None:
        """Restore a state that a board of the same library has saved."""
        self._call("host_restore", state)

    def _call(self, name: str, *arguments: Any) -> Any:
        return self._library.call(self, name, *arguments)


class _Library:
    """A loaded library, in which one board is present. The states of others are with them."""

    def __init__(self, path: Path) -> None:
        self.functions = ctypes.CDLL(str(path))
        self.functions.host_set.argtypes = [ctypes.c_char_p, ctypes.c_double]
        for name in ("host_new", "host_set"):
            getattr(self.functions, name).restype = ctypes.c_bool
        self.state_bytes: int = self.functions.host_state_bytes()
        self.view_type = _view_type()
        self._lock = RLock()
        self._present: Sketch | None = None

    @classmethod
    @cache
    def load(cls, path: Path) -> "_Library":
        """Return the library of a path. It stays loaded."""
        return cls(path)

    def make(self, board: Sketch) -> None:
        """Make a board, which is then present."""
        with self._lock:
            self._put_away()
            if not self.functions.host_new():
                raise ProcessError("the linker does not keep the sketch's variables together")
            self._present = board

    def call(self, board: Sketch, name: str, *arguments: Any) -> Any:
        """Call a function with a board present."""
        with self._lock:
            if self._present is not board:
                self._put_away()
                self.functions.host_restore(board.state)
                self._present = board
            return getattr(self.functions, name)(*arguments)

    def _put_away(self) -> None:
        if self._present is not None:
            self.functions.host_save(self._present.state)


def _view_type() -> type[ctypes.Structure]:
    """Return the structure `host_view`, whose fields are read in host.h."""
    text = (FIRMWARE / "host" / "host.h").read_text("utf-8")
    (body,) = re.findall(r"struct host_view {(.*?)};", text, re.DOTALL)
    fields = [
        (name, getattr(ctypes, f"c_{kind.removesuffix('_t')}"))
        for kind, names in re.findall(r"^  (\w+) ([\w, ]+);", body, re.MULTILINE)
        for name in names.split(", ")
    ]
    return type("View", (ctypes.Structure,), {"_fields_": fields})


def _compiler() -> str | None:
    return next(filter(None, map(shutil.which, COMPILERS)), None)


def _digest(firmware: Path) -> str:
    """Return what a library depends on, as a name: its sources, options, compiler and machine."""
    digest = hashlib.sha256(repr((OPTIONS, _compiler(), platform.machine())).encode())
    for path in sorted(firmware.rglob("*")):
        if path.suffix in (".h", ".cpp", ".ino"):
            digest.update(path.relative_to(firmware).as_posix().encode() + b"\0")
            digest.update(path.read_bytes())
    return digest.hexdigest()[:24]


@cache
def _cache_folder() -> Path:
    """Return the folder of compiled libraries: the user's cache, else one until this process ends.

    Never one that others can write to, as the library is executed.
    """
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = (Path(base) if base else Path.home() / ".cache") / "telepulse"
        folder.mkdir(parents=True, exist_ok=True)
        with TemporaryDirectory(dir=folder):
            return folder
    except (OSError, RuntimeError):
        global _own_folder
        _own_folder = TemporaryDirectory(prefix="telepulse-")
        return Path(_own_folder.name)
