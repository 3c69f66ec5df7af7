"""The log of a session: a JSON line for the session, then one for each trial, on the disk at once.

A line that a crash cut short is the last, and is left out.

Results of logs: answers by condition, from one subject or several.
"""

import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from protocol.config.scene import validate
from protocol.errors import OutputError, TelepulseError
from telepulse.experiment.interval import PlayedInterval, error_share
from telepulse.experiment.psychometrics import IntervalErrors, Proportion
from telepulse.experiment.session import Kind, SessionTable, Trial


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


class SessionHeader(_Line):
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


class AnsweredTrial(_Line):
    """A trial. answer: what X was said to be, or the rating; response_s: from when the trial
    began, None of a simulated observer; played: every interval felt, in order."""

    line: Literal["trial"] = "trial"
    time: str
    index: int = Field(ge=0)
    answer: Literal["A", "B", 1, 2, 3, 4, 5]
    response_s: float | None
    played: tuple[PlayedInterval, ...] = Field(min_length=1)


class ResumedSession(_Line):
    """The session goes on."""

    line: Literal["resumed"] = "resumed"
    version: str
    time: str
    provenance: dict[str, Any] = Field(default_factory=dict)


_LINE: TypeAdapter[SessionHeader | AnsweredTrial | ResumedSession] = TypeAdapter(
    SessionHeader | AnsweredTrial | ResumedSession
)


@dataclass(frozen=True, slots=True)
class SessionLog:
    """A log, read. whole_bytes: up to the end of its last whole line."""

    path: Path
    header: SessionHeader
    session: SessionTable
    answered: tuple[AnsweredTrial, ...]
    whole_bytes: int

    @property
    def finished(self) -> bool:
        """True where all trials were answered."""
        return len(self.answered) == len(self.header.trials)


def read_log(path: Path) -> SessionLog:
    """Read a log. Raises LogError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from None
    whole_bytes = data.rfind(b"\n") + 1
    lines = [_parse(path, n, line) for n, line in enumerate(data[:whole_bytes].splitlines(), 1)]
    if not lines or not isinstance(lines[0], SessionHeader):
        raise LogError(f"{path}: no log of a session: its first line is none of a session")
    header = lines[0]
    answered = tuple(line for line in lines if isinstance(line, AnsweredTrial))
    if [line.index for line in answered] != list(range(len(answered))) or len(answered) > len(
        header.trials
    ):
        raise LogError(f"{path}: its trials are not in order; was it edited?")
    session = validate(header.tables.get("session"), SessionTable, where=f"{path}: session:")
    return SessionLog(path, header, session, answered, whole_bytes)


def _parse(path: Path, number: int, line: bytes) -> SessionHeader | AnsweredTrial | ResumedSession:
    try:
        return _LINE.validate_json(line)
    except ValidationError:
        raise LogError(f"{path}: line {number}: no line of a session's log") from None


class SessionLogFile:
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

    def write(self, line: SessionHeader | AnsweredTrial | ResumedSession) -> None:
        """Append a line. Raises OutputError."""
        try:
            self._file.write(line.model_dump_json().encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from None


# The paper asked whether it was felt "close to a direct touch".
CLOSE = 4


@dataclass(frozen=True, slots=True)
class TrialOutcome:
    """An answered trial."""

    subject: str
    trial: Trial
    answered: AnsweredTrial

    @property
    def correct(self) -> bool:
        """True where X was named rightly; of no meaning in a catch trial."""
        return self.answered.answer == self.trial.x

    @property
    def rating(self) -> int:
        """1 to 5."""
        return int(self.answered.answer)

    @property
    def spoilt(self) -> str:
        """Reason why this trial is not what it was to be, "" where it is."""
        return next((why for played in self.answered.played if (why := played.spoilt)), "")

    @property
    def stale(self) -> bool:
        """True where the link left the stream stale in an interval."""
        return any(played.on_link and played.stale for played in self.answered.played)

    @property
    def errors(self) -> IntervalErrors:
        """Aligned force errors of A, B and X as shares of the pulse; NaN of what was not felt."""
        played = self.answered.played
        return IntervalErrors(*(error_share(played, letter) for letter in ("A", "B", "X")))

    def force_mn(self, on_link: bool, field: str) -> float:
        """Mean force error of the intervals over the link, or of the direct ones, in mN."""
        values = [
            getattr(p, field)
            for p in self.answered.played
            if p.on_link is on_link and getattr(p, field) is not None
        ]
        return 1e3 * float(np.mean(values)) if values else float("nan")


@dataclass(frozen=True, slots=True)
class SessionResults:
    """All outcomes that count, in order, and the conditions in the order of the session file.

    spoilt: further outcomes, in which ticks were missed or the stream was stale; pooled: they are
    among the outcomes as well. who: answered, in one word of each kind: people and observers are
    never pooled.
    """

    kind: Kind
    title: str
    conditions: tuple[str, ...]
    subjects: tuple[str, ...]
    outcomes: tuple[TrialOutcome, ...]
    asked: int
    spoilt: tuple[TrialOutcome, ...] = ()
    pooled: bool = False
    who: str = "a person"
    thresholds: tuple[float, ...] = ()
    versions: tuple[str, ...] = ()

    def of(self, condition: str | None) -> list[TrialOutcome]:
        """A condition's outcomes; None: those of catch trials."""
        return [o for o in self.outcomes if o.trial.condition == condition]

    @property
    def tested(self) -> list[TrialOutcome]:
        """All but catch trials."""
        return [o for o in self.outcomes if o.trial.condition is not None]

    def by_condition(self) -> Iterator[tuple[str, list[TrialOutcome]]]:
        """The conditions that were answered."""
        return ((name, found) for name in self.conditions if (found := self.of(name)))


def gather(logs: Sequence[SessionLog], with_spoilt: bool = False) -> SessionResults:
    """Pool logs of one kind of subject, session and scene. Raises LogError.

    with_spoilt: count spoilt trials with the others; they are counted too where there are no
    others.
    """
    first = logs[0]
    names = [log.path.stem for log in logs]
    for log in logs[1:]:
        mine, theirs = log.session, first.session
        if (mine.kind, mine.conditions) != (theirs.kind, theirs.conditions):
            raise LogError(f"{log.path}: other conditions than in {first.path}; report them apart")
        if what := _difference(log, first):
            raise LogError(f"{log.path}: {what}; report them apart")
    found = tuple(
        TrialOutcome(name, log.header.trials[answered.index], answered)
        for name, log in zip(names, logs, strict=True)
        for answered in log.answered
    )
    spoilt = tuple(outcome for outcome in found if outcome.spoilt)
    clean = tuple(outcome for outcome in found if not outcome.spoilt)
    # Without a clean trial the spoilt ones are all that there is to report, as spoilt.
    pooled = with_spoilt or not any(o.trial.condition is not None for o in clean)
    outcomes = found if pooled else clean
    if not any(o.trial.condition is not None for o in outcomes):
        raise LogError(f"{first.path}: no trial of a condition is answered yet")
    return SessionResults(
        kind=first.session.kind,
        title=first.session.title or first.path.stem,
        conditions=tuple(condition.name for condition in first.session.conditions),
        subjects=tuple(dict.fromkeys(names)),
        outcomes=outcomes,
        asked=sum(len(log.header.trials) for log in logs),
        spoilt=spoilt,
        pooled=pooled,
        who=first.header.subject,
        thresholds=tuple(
            sorted({log.header.threshold for log in logs if log.header.threshold is not None})
        ),
        versions=tuple(sorted({_version(log) for log in logs})),
    )


# What may differ between the sittings of one experiment.
FREE_KEYS = {"title", "trials", "catch", "seed"}


def _difference(log: SessionLog, first: SessionLog) -> str:
    """Return how a log differs from the first so that they cannot be pooled, "" where not."""
    if log.header.subject != first.header.subject:
        return f"answered by {log.header.subject}, {first.path} by {first.header.subject}"
    if log.header.tables.get("scene") != first.header.tables.get("scene"):
        return f"another scene than in {first.path}"
    mine, theirs = (each.session.model_dump() for each in (log, first))
    differing = [key for key in mine if key not in FREE_KEYS and mine[key] != theirs[key]]
    return f"another {', '.join(differing)} than in {first.path}" if differing else ""


def _version(log: SessionLog) -> str:
    """Return the version that wrote a log, with its commit where it is known."""
    commit = log.header.provenance.get("commit")
    return f"{log.header.version} ({commit})" if commit else log.header.version


def correct(outcomes: Iterable[TrialOutcome]) -> Proportion:
    """Return the proportion named rightly."""
    hits = [o.correct for o in outcomes]
    return Proportion(sum(hits), len(hits))


def close(outcomes: Iterable[TrialOutcome]) -> Proportion:
    """Return the proportion rated close to a direct touch, or the same."""
    hits = [o.rating >= CLOSE for o in outcomes]
    return Proportion(sum(hits), len(hits))
