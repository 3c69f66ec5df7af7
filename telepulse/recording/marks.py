"""Sources of marks beside a recorder, and what a person states about a recording.

Marks are published by the display (`protocol.wire.marks`). Statements are written by the recorder
alone.
"""

import os
import threading
import time
from collections import deque
from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol

from protocol.errors import SourceError, suggest
from protocol.wire.marks import printable
from pulse_sensors import library

# Keys that may be stated, and the limit of their texts.
STATED = ("subject", "position", "side", "notes")
MOST_CHARACTERS = 1000
STDIN = 0
RESOLVE_S = 5.0


class TakenMark(NamedTuple):
    """Text of a mark, empty for a numbered one, and its age in ns when it is taken."""

    text: str
    age_ns: int


class MarkSource(Protocol):
    """A source of marks."""

    def take(self) -> list[TakenMark]:
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
        about[key] = printable(value, MOST_CHARACTERS)
    return about


class LineMarks:
    """Marks by the lines of standard input, which a thread reads."""

    def __init__(self) -> None:
        self._waiting: deque[tuple[int, str]] = deque()
        threading.Thread(target=self._read, daemon=True).start()

    def take(self) -> list[TakenMark]:
        """See `MarkSource.take`."""
        now_ns, marks = time.perf_counter_ns(), []
        while self._waiting:
            at_ns, text = self._waiting.popleft()
            marks.append(TakenMark(text, now_ns - at_ns))
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

    def take(self) -> list[TakenMark]:
        """See `MarkSource.take`."""
        samples: list[list[Any]]
        samples, times_s = self._inlet.pull_chunk(timeout=0.0)
        now_s = self._lsl.local_clock()
        return [
            TakenMark(
                printable(" ".join(map(str, sample))),
                max(0, round((now_s - at_s - self._ahead_s) * 1e9)),
            )
            for sample, at_s in zip(samples, times_s, strict=True)
        ]
