"""Marks of a person or a program, and what a person states about a recording.

They are written by the recorder alone: the display does not receive them, so that no peer does.
"""

import os
import threading
import time
from collections import deque
from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol

from protocol.errors import SourceError, suggest
from pulse_sensors import library

# Keys that may be stated, and limits of their texts and of a mark.
STATED = ("subject", "position", "side", "notes")
MOST_CHARACTERS = 1000
STDIN = 0
RESOLVE_S = 5.0


class Mark(NamedTuple):
    """A mark, and its age in ns when it is taken."""

    text: str
    age_ns: int


class MarkSource(Protocol):
    """A source of marks."""

    def take(self) -> list[Mark]:
        """Return the marks since the last call."""


def read_about(texts: Iterable[str]) -> dict[str, str]:
    """Return texts such as "subject=S01" by their keys. Raises SourceError."""
    about: dict[str, str] = {}
    for text in texts:
        key, equals, value = text.partition("=")
        if not equals or key not in STATED:
            known = ", ".join(f"{each}=TEXT" for each in STATED)
            advice = suggest(key, STATED) or f"; known: {known}"
            raise SourceError(f"--about: {text[:80]!r} is none of its keys{advice}")
        if key in about:
            raise SourceError(f"--about: {key} is given twice")
        about[key] = printable(value)
    return about


def printable(text: str) -> str:
    """Return a text in one line, without what a terminal cannot show."""
    return "".join(each if each.isprintable() else " " for each in text).strip()[:MOST_CHARACTERS]


class LineMarks:
    """Marks by the lines of standard input; an empty one is numbered. A thread reads them."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, str]] = deque()
        self._number = 0
        threading.Thread(target=self._read, daemon=True).start()

    def take(self) -> list[Mark]:
        """See `MarkSource.take`."""
        now_ns, marks = time.perf_counter_ns(), []
        while self._waiting:
            at_ns, text = self._waiting.popleft()
            self._number += 1
            marks.append(Mark(text or f"mark {self._number}", now_ns - at_ns))
        return marks

    def _read(self) -> None:
        rest = b""
        # Not by sys.stdin, whose lock a thread that waits would hold at the end of the process.
        while True:
            try:
                data = os.read(STDIN, 4096)
            except OSError:
                return
            now_ns = time.perf_counter_ns()
            *lines, rest = (rest + data).split(b"\n")
            rest = rest[-MOST_CHARACTERS:]
            if not data and rest:
                lines, rest = [rest], b""
            for line in lines:
                self._waiting.append((now_ns, printable(line.decode("utf-8", "replace"))))
            if not data:
                return


class LslMarks:
    """Marks by a stream of LSL with texts, as programs that show stimuli send them."""

    def __init__(self, name: str) -> None:
        """Find the stream. Raises SourceError."""
        lsl = library("pylsl", "--marks-from")
        found = lsl.resolve_byprop("name", name, 1, RESOLVE_S)
        if not found:
            raise SourceError(f"LSL stream {name}: not found within {RESOLVE_S:g} s")
        if found[0].channel_format() != lsl.cf_string:
            raise SourceError(f"LSL stream {name}: has numbers, and a mark is a text")
        self._lsl, self._inlet = lsl, lsl.StreamInlet(found[0])
        try:
            self._inlet.open_stream(RESOLVE_S)
            self._ahead_s = float(self._inlet.time_correction(RESOLVE_S))
        except Exception as error:  # pylsl has errors of its own for a stream that is gone
            raise SourceError(f"LSL stream {name}: {error}") from None

    def take(self) -> list[Mark]:
        """See `MarkSource.take`."""
        samples: list[list[Any]]
        samples, times_s = self._inlet.pull_chunk(timeout=0.0)
        now_s = self._lsl.local_clock()
        return [
            Mark(
                printable(" ".join(map(str, sample))),
                max(0, round((now_s - at_s - self._ahead_s) * 1e9)),
            )
            for sample, at_s in zip(samples, times_s, strict=True)
        ]
