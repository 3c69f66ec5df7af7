"""The log of a session, and the results of one log or several.

The first line of a log describes the session; each further one is a trial. The lines are JSON, and
each is written to the disk at once. An incomplete last line, as after a crash, is ignored.
"""

import os
from collections.abc import Iterable, Iterator, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from random import SystemRandom
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from protocol.config.scene import validate
from protocol.errors import OutputError, TelepulseError
from telepulse.experiment.interval import PlayedInterval, interval_errors
from telepulse.experiment.psychometrics import IntervalErrors, Proportion
from telepulse.experiment.session import Kind, SessionPlan, SessionTable, Trial, draw_trials
from telepulse.scene import scene_provenance


class LogError(TelepulseError, ValueError):
    """A session's log cannot be used.

    Example scenarios: no such file, an edited line, logs of two experiments in one report.
    """


def now() -> str:
    """Return the present time in the log's format."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


Answer = Literal["A", "B", 1, 2, 3, 4, 5]
"""The letter that X was identified as, or the rating."""


class _Line(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class SessionHeader(_Line):
    """The first line.

    tables: session file and scene as written. threshold: of the simulated observer; None for a
    person. felt_on: "models" where there is no drive, so that nobody feels anything. provenance: of
    the run. Logs of older versions lack the last two.
    """

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
        """Kind of subject and bench; only answers of one kind may be pooled."""
        if self.threshold is not None:
            return "a simulated observer"
        return "a person on the scene's models" if self.felt_on == "models" else "a person"


class AnsweredTrial(_Line):
    """The line of an answered trial.

    response_s: time from the trial's start to the answer; None for a simulated observer. played:
    every interval that was felt, in order.
    """

    line: Literal["trial"] = "trial"
    time: str
    index: int = Field(ge=0)
    answer: Answer
    response_s: float | None
    played: tuple[PlayedInterval, ...] = Field(min_length=1)


class ResumedSession(_Line):
    """The line at which a session was resumed."""

    line: Literal["resumed"] = "resumed"
    version: str
    time: str
    provenance: dict[str, Any] = Field(default_factory=dict)


LogLine = SessionHeader | AnsweredTrial | ResumedSession
_LINE: TypeAdapter[LogLine] = TypeAdapter(LogLine)


class SessionLog(NamedTuple):
    """A log that was read. whole_bytes: length of the file up to the last complete line."""

    path: Path
    header: SessionHeader
    session: SessionTable
    answered: tuple[AnsweredTrial, ...]
    whole_bytes: int

    @property
    def version(self) -> str:
        """Version that wrote the log, with its commit if that is known."""
        commit = self.header.provenance.get("commit")
        return f"{self.header.version} ({commit})" if commit else self.header.version


def read_log(path: Path) -> SessionLog:
    """Read a log. Raises LogError."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from None
    whole_bytes = data.rfind(b"\n") + 1
    lines: list[LogLine] = []
    for number, line in enumerate(data[:whole_bytes].splitlines(), 1):
        try:
            lines.append(_LINE.validate_json(line))
        except ValidationError:
            raise LogError(f"{path}: line {number}: not a line of a session's log") from None
    if not lines or not isinstance(lines[0], SessionHeader):
        raise LogError(f"{path}: not a log: its first line is not that of a session")
    header = lines[0]
    answered = tuple(line for line in lines if isinstance(line, AnsweredTrial))
    indices = [line.index for line in answered]
    if indices != list(range(len(header.trials)))[: len(indices)]:
        raise LogError(f"{path}: the trials are not in order: the file was edited")
    session = validate(header.tables.get("session"), SessionTable, where=f"{path}: session:")
    return SessionLog(path, header, session, answered, whole_bytes)


class SessionLogFile:
    """A log that is written; each line is on the disk when `write` returns.

    append_at: length after which to continue an existing log; None: a new file. Raises
    OutputError.
    """

    def __init__(self, path: Path, append_at: int | None = None) -> None:
        self._path = path
        try:
            self._file = path.open("xb" if append_at is None else "ab")
            if append_at is not None:
                self._file.truncate(append_at)
        except FileExistsError:
            raise OutputError(
                f"{path}: exists already; continue it by --resume, or name another file"
            ) from None
        except OSError as error:
            raise OutputError(f"{path}: cannot be written: {error.strerror}") from None

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def write(self, line: LogLine) -> None:
        """Append a line. Raises OutputError."""
        try:
            self._file.write(line.model_dump_json().encode() + b"\n")
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be written: {error.strerror}") from None


def open_log(
    path: Path, plan: SessionPlan, threshold: float | None, resume: bool
) -> tuple[SessionLogFile, SessionHeader, int]:
    """Return the log to write, its header, and the number of answered trials.

    A log that is resumed must have the same session, scene and observer. Raises LogError or
    OutputError.
    """
    made_up = plan.direct.display.drive is None or threshold is not None
    if not resume:
        seed = plan.session.seed
        seed = SystemRandom().getrandbits(31) if seed is None else seed
        header = SessionHeader(
            version=version("telepulse"),
            time=now(),
            tables=plan.tables,
            seed=seed,
            threshold=threshold,
            trials=draw_trials(plan.session, seed),
            felt_on="models" if made_up else "drive",
            provenance=scene_provenance(plan.direct, {"session": seed}).to_dict(),
        )
        file = SessionLogFile(path)
        file.write(header)
        return file, header, 0
    log = read_log(path)
    if (log.header.tables, log.header.threshold) != (plan.tables, threshold):
        raise LogError(
            f"{path}: session, scene or observer differ from those in the log's first line"
        )
    file = SessionLogFile(path, log.whole_bytes)
    made = scene_provenance(plan.direct, {"session": log.header.seed}).to_dict()
    file.write(ResumedSession(version=version("telepulse"), time=now(), provenance=made))
    return file, log.header, len(log.answered)


class TrialOutcome(NamedTuple):
    """An answered trial with its subject and its conditions."""

    subject: str
    trial: Trial
    answered: AnsweredTrial

    @property
    def correct(self) -> bool:
        """True if X was identified correctly; meaningless in a catch trial."""
        return self.answered.answer == self.trial.x

    @property
    def rating(self) -> int:
        """The rating, 1 to 5."""
        return int(self.answered.answer)

    @property
    def spoilt(self) -> str:
        """Reason why the machine spoilt the trial, or ""."""
        return next((why for played in self.answered.played if (why := played.spoilt)), "")

    @property
    def stale(self) -> bool:
        """True if the stream over the link was stale in an interval."""
        return any(played.on_link and played.stale for played in self.answered.played)

    @property
    def errors(self) -> IntervalErrors:
        """Aligned force errors of A, B and X as shares of the pulse; NaN where not felt."""
        return interval_errors(self.answered.played)

    def force_mn(self, on_link: bool, field: str) -> float:
        """Return the mean force error of the intervals over the link, or the direct ones, in mN."""
        played = [p for p in self.answered.played if p.on_link is on_link]
        values = [value for p in played if (value := getattr(p, field)) is not None]
        return 1e3 * float(np.mean(values)) if values else float("nan")


class SessionResults(NamedTuple):
    """All outcomes that count, in order, and the conditions in the order of the session file.

    spoilt: outcomes in which ticks were missed or a direct stream was stale. pooled: True if
    `outcomes` includes them. who: the kind of subject; kinds are never pooled.
    """

    kind: Kind
    title: str
    conditions: tuple[str, ...]
    subjects: tuple[str, ...]
    outcomes: tuple[TrialOutcome, ...]
    trials: int
    spoilt: tuple[TrialOutcome, ...]
    pooled: bool
    who: str
    thresholds: tuple[float, ...]
    versions: tuple[str, ...]

    def of(self, condition: str | None) -> list[TrialOutcome]:
        """Return a condition's outcomes; None: those of catch trials."""
        return [o for o in self.outcomes if o.trial.condition == condition]

    @property
    def tested(self) -> list[TrialOutcome]:
        """All but catch trials."""
        return [o for o in self.outcomes if o.trial.condition is not None]

    def by_condition(self) -> Iterator[tuple[str, list[TrialOutcome]]]:
        """Return the conditions that have answers, with their outcomes."""
        return ((name, found) for name in self.conditions if (found := self.of(name)))


def gather(logs: Sequence[SessionLog], with_spoilt: bool = False) -> SessionResults:
    """Pool logs of one kind of subject, session and scene. Raises LogError.

    with_spoilt: include spoilt trials; without any other trials they are always included.
    """
    first = logs[0]
    for log in logs[1:]:
        mine, theirs = log.session, first.session
        if (mine.kind, mine.conditions) != (theirs.kind, theirs.conditions):
            raise LogError(
                f"{log.path}: other conditions than in {first.path}; report them separately"
            )
        if what := _difference(log, first):
            raise LogError(f"{log.path}: {what}; report them separately")
    found = tuple(
        TrialOutcome(log.path.stem, log.header.trials[answered.index], answered)
        for log in logs
        for answered in log.answered
    )
    if all(o.trial.condition is None for o in found):
        raise LogError(f"{first.path}: no trial of a condition is answered yet")
    clean = tuple(outcome for outcome in found if not outcome.spoilt)
    pooled = with_spoilt or all(o.trial.condition is None for o in clean)
    return SessionResults(
        kind=first.session.kind,
        title=first.session.title or first.path.stem,
        conditions=tuple(condition.name for condition in first.session.conditions),
        subjects=tuple(dict.fromkeys(log.path.stem for log in logs)),
        outcomes=found if pooled else clean,
        trials=sum(len(log.header.trials) for log in logs),
        spoilt=tuple(outcome for outcome in found if outcome.spoilt),
        pooled=pooled,
        who=first.header.subject,
        thresholds=tuple(sorted({t for log in logs if (t := log.header.threshold) is not None})),
        versions=tuple(sorted({log.version for log in logs})),
    )


def _difference(log: SessionLog, first: SessionLog) -> str:
    """Return the difference that keeps a log from being pooled with the first, or ""."""
    if log.header.subject != first.header.subject:
        return f"answered by {log.header.subject}, {first.path} by {first.header.subject}"
    if log.header.tables.get("scene") != first.header.tables.get("scene"):
        return f"another scene than in {first.path}"
    # These keys may differ between the sessions of one experiment.
    free = {"title", "trials", "catch", "seed"}
    mine, theirs = (each.session.model_dump(exclude=free) for each in (log, first))
    differing = [key for key in mine if mine[key] != theirs[key]]
    return f"another {', '.join(differing)} than in {first.path}" if differing else ""


def share_correct(outcomes: Iterable[TrialOutcome]) -> Proportion:
    """Return the proportion of correct answers."""
    hits = [o.correct for o in outcomes]
    return Proportion(sum(hits), len(hits))


def share_close(outcomes: Iterable[TrialOutcome]) -> Proportion:
    """Return the proportion rated close to a direct touch, or the same."""
    # The paper asked whether X was "close to a direct touch", which is the rating 4.
    hits = [o.rating >= 4 for o in outcomes]
    return Proportion(sum(hits), len(hits))
