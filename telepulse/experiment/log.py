"""The log of a session, and its results by condition, with exact intervals.

The log is one JSON object a line, which `pandas.read_json(lines=True)` reads.

The first line describes the session; each further one is a trial with its conditions, its answer
and its errors. Each is written to the disk at once. An incomplete last line, as after a crash, is
ignored.
"""

import math
import os
from collections.abc import Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from random import SystemRandom
from typing import Annotated, Any, BinaryIO, Literal, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from protocol.config.quantities import count_text
from protocol.config.scene import validate
from protocol.errors import OutputError, TelepulseError
from protocol.input_files import read_regular
from telepulse.experiment.interval import PlayedInterval, interval_errors
from telepulse.experiment.session import SessionPlan, SessionTable, Trial, draw_trials
from telepulse.scene import scene_provenance


class LogError(TelepulseError, ValueError):
    """A session's log cannot be used.

    Example scenarios: no such file, an edited line, a log of another session.
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
    the run.
    """

    line: Literal["session"] = "session"
    version: str
    time: str
    tables: dict[str, Any]
    seed: int
    threshold: float | None
    trials: tuple[Trial, ...]
    felt_on: Literal["drive", "models"]
    provenance: dict[str, Any]


Share = Annotated[float, Field(allow_inf_nan=False)]


class AnsweredTrial(_Line):
    """The line of an answered trial.

    Attributes
    ----------
    condition, direct, x, pulse_seed
        Those of the `Trial`.
    answer
        The letter that X was identified as, or the rating.
    correct : bool or None
        Whether X was identified; None for a rating, and in a catch trial, which has no right
        answer.
    response_s : float or None
        Time from the trial's start to the answer; None for a simulated observer.
    error_a, error_b, error_x : float or None
        Mean aligned force error of a letter's intervals over the direct pulse from peak to peak;
        None for a letter that was not felt.
    spoilt : str
        Why the machine spoilt the trial, or "".
    stale : bool
        Whether the stream over the link was stale in an interval: an effect of the condition.
    played
        Every interval that was felt, in order.
    """

    line: Literal["trial"] = "trial"
    time: str
    index: int = Field(ge=0)
    condition: str | None
    direct: Literal["A", "B"]
    x: Literal["A", "B"]
    pulse_seed: int
    answer: Answer
    correct: bool | None
    response_s: float | None
    error_a: Share | None
    error_b: Share | None
    error_x: Share | None
    spoilt: str
    stale: bool
    played: tuple[PlayedInterval, ...] = Field(min_length=1)

    @classmethod
    def of(
        cls,
        index: int,
        trial: Trial,
        answer: Answer,
        played: Sequence[PlayedInterval],
        response_s: float | None = None,
    ) -> "AnsweredTrial":
        """Return the line of a trial that was answered now."""
        shares = (None if math.isnan(each) else each for each in interval_errors(played))
        judged = isinstance(answer, str) and trial.condition is not None
        return cls(
            time=now(),
            index=index,
            answer=answer,
            correct=answer == trial.x if judged else None,
            response_s=response_s,
            spoilt=next((why for each in played if (why := each.spoilt)), ""),
            stale=any(each.on_link and each.stale for each in played),
            played=tuple(played),
            **trial.model_dump(),
            **dict(zip(("error_a", "error_b", "error_x"), shares, strict=True)),
        )


class ResumedSession(_Line):
    """The line at which a session was resumed."""

    line: Literal["resumed"] = "resumed"
    version: str
    time: str
    provenance: dict[str, Any]


LogLine = SessionHeader | AnsweredTrial | ResumedSession
_LINE: TypeAdapter[LogLine] = TypeAdapter(LogLine)


# Largest log that is read: a trial's line has 500 bytes.
MOST_BYTES = 1 << 24


class SessionLog(NamedTuple):
    """A log that was read. whole_bytes: length of the file up to the last complete line."""

    header: SessionHeader
    session: SessionTable
    answered: tuple[AnsweredTrial, ...]
    whole_bytes: int


def read_log(path: Path) -> SessionLog:
    """Read a log. Raises LogError."""
    try:
        data = read_regular(path, MOST_BYTES)
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
    return SessionLog(header, session, answered, whole_bytes)


def write_line(file: BinaryIO, line: LogLine) -> None:
    """Append a line, which is on the disk on return. Raises OutputError."""
    try:
        file.write(line.model_dump_json().encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())
    except OSError as error:
        raise OutputError(f"{file.name}: cannot be written: {error.strerror}") from None


def open_log(
    path: Path, plan: SessionPlan, threshold: float | None, resume: bool
) -> tuple[BinaryIO, SessionHeader, int]:
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
        file = _open_file(path)
        write_line(file, header)
        return file, header, 0
    log = read_log(path)
    if (log.header.tables, log.header.threshold) != (plan.tables, threshold):
        raise LogError(
            f"{path}: session, scene or observer differ from those in the log's first line"
        )
    file = _open_file(path, log.whole_bytes)
    made = scene_provenance(plan.direct, {"session": log.header.seed}).to_dict()
    write_line(file, ResumedSession(version=version("telepulse"), time=now(), provenance=made))
    return file, log.header, len(log.answered)


def _open_file(path: Path, append_at: int | None = None) -> BinaryIO:
    """Open a new log, or continue an existing one after a length. Raises OutputError."""
    try:
        file = path.open("xb" if append_at is None else "ab")
        if append_at is not None:
            file.truncate(append_at)
        return file
    except FileExistsError:
        raise OutputError(
            f"{path}: exists already; continue it by --resume, or name another file"
        ) from None
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None


# A rating from here on is "close to a direct touch", which is what the paper asked.
CLOSE = 4


def show_results(log: SessionLog, console: Console) -> None:
    """Print the answers of a session, and what qualifies them.

    Spoilt trials are left out. An interval is exact (Clopper and Pearson), of a level of 95 %.
    """
    clean = [each for each in log.answered if not each.spoilt]
    abx = log.session.kind == "abx"
    table = Table("condition", "X identified" if abx else "rated close", "95 %", "link error, mN")
    for condition in log.session.conditions:
        found = [each for each in clean if each.condition == condition.name]
        if found:
            hits = sum(bool(each.correct) if abx else int(each.answer) >= CLOSE for each in found)
            interval = binomtest(hits, len(found)).proportion_ci(0.95, method="exact")
            between = f"{100 * interval.low:.1f} to {100 * interval.high:.1f} %"
            of = f"{hits} of {len(found)}"
            table.add_row(condition.name, of, between, _link_error_mn(found))
    if table.row_count:
        console.print(table)
    for remark in _remarks(log):
        console.print(remark)


def _remarks(log: SessionLog) -> list[str]:
    remarks = []
    if log.header.threshold is not None:
        shown = f"{100 * log.header.threshold:g} %"
        remarks.append(f"Simulated: an observer with a threshold of {shown}; nobody felt anything.")
    elif log.header.felt_on == "models":
        remarks.append("Nobody felt anything: the scene's models ran, without a drive.")
    spoilt = sum(bool(each.spoilt) for each in log.answered)
    if spoilt:
        remarks.append(f"{count_text(spoilt, 'trial')} spoilt by the machine, and left out.")
    stale = sum(each.stale for each in log.answered)
    if stale:
        remarks.append(f"The stream was stale over the link in {count_text(stale, 'trial')}.")
    return remarks


def _link_error_mn(answered: Sequence[AnsweredTrial]) -> str:
    played = [each for trial in answered for each in trial.played if each.on_link]
    errors_n = [each.aligned_n for each in played if each.aligned_n is not None]
    return f"{1e3 * np.mean(errors_n):.2f}" if errors_n else "–"
