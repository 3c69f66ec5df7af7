"""The log of a session: a JSON line for the session, then one for each trial, on the disk at once.

A line that a crash cut short is the last, and is left out.
"""

import os
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from protocol.config.scene import validate
from protocol.errors import OutputError, TelepulseError
from telepulse.experiment.interval import PlayedInterval
from telepulse.experiment.session import Session, Trial


class LogError(TelepulseError, ValueError):
    """A session's log cannot be read, or does not go with what it is used for."""


def now() -> str:
    """The time, as in the log."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def our_version() -> str:
    """Telepulse's."""
    return version("telepulse")


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Header(_Line):
    """The first line. tables: session file and scene as written; threshold: of the simulated
    observer, None for a person. felt_on: "drive", or "models", on which nobody feels anything.
    provenance: of the run. Logs of before these two have neither."""

    line: Literal["session"] = "session"
    version: str
    time: str
    tables: dict[str, Any]
    seed: int
    threshold: float | None
    trials: tuple[Trial, ...]
    felt_on: Literal["drive", "models"] | None = None
    provenance: dict[str, Any] = Field(default_factory=dict)

    @property
    def subject(self) -> str:
        """The one who answers, and on what: answers of one kind alone may be pooled."""
        if self.threshold is not None:
            return "a simulated observer"
        return "a person on the scene's models" if self.felt_on == "models" else "a person"


class Answered(_Line):
    """A trial. answer: what X was said to be, or the rating; response_s: from when the trial
    began, None of a simulated observer; played: every interval felt, in order."""

    line: Literal["trial"] = "trial"
    time: str
    index: int = Field(ge=0)
    answer: Literal["A", "B", 1, 2, 3, 4, 5]
    response_s: float | None
    played: tuple[PlayedInterval, ...] = Field(min_length=1)


class Resumed(_Line):
    """The session goes on."""

    line: Literal["resumed"] = "resumed"
    version: str
    time: str
    provenance: dict[str, Any] = Field(default_factory=dict)


_LINE: TypeAdapter[Header | Answered | Resumed] = TypeAdapter(Header | Answered | Resumed)


@dataclass(frozen=True, slots=True)
class Log:
    """A log, read. whole_bytes: up to the end of its last whole line."""

    path: Path
    header: Header
    session: Session
    answered: tuple[Answered, ...]
    whole_bytes: int

    @property
    def finished(self) -> bool:
        """True where all trials were answered."""
        return len(self.answered) == len(self.header.trials)


def read_log(path: Path) -> Log:
    """Read a log. Raises LogError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from None
    whole_bytes = data.rfind(b"\n") + 1
    lines = [_parse(path, n, line) for n, line in enumerate(data[:whole_bytes].splitlines(), 1)]
    if not lines or not isinstance(lines[0], Header):
        raise LogError(f"{path}: no log of a session: its first line is none of a session")
    header = lines[0]
    answered = tuple(line for line in lines if isinstance(line, Answered))
    if [line.index for line in answered] != list(range(len(answered))) or len(answered) > len(
        header.trials
    ):
        raise LogError(f"{path}: its trials are not in order; was it edited?")
    session = validate(header.tables.get("session"), Session, where=f"{path}: session:")
    return Log(path, header, session, answered, whole_bytes)


def _parse(path: Path, number: int, line: bytes) -> Header | Answered | Resumed:
    try:
        return _LINE.validate_json(line)
    except ValidationError:
        raise LogError(f"{path}: line {number}: no line of a session's log") from None


class LogFile:
    """A log that is written; each line is on the disk when `write` returns."""

    def __init__(self, path: Path, go_on_at: int | None = None) -> None:
        """A new file, or one that goes on after so many bytes. Raises OutputError."""
        self._path = path
        try:
            self._file = path.open("xb" if go_on_at is None else "ab")
            if go_on_at is not None:
                self._file.truncate(go_on_at)
        except FileExistsError:
            raise OutputError(
                f"{path}: is there already; go on with it by --resume, or name another file"
            ) from None
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def write(self, line: Header | Answered | Resumed) -> None:
        """Append a line. Raises OutputError."""
        try:
            self._file.write(line.model_dump_json().encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from None
