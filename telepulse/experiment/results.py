"""What logs say: answers by condition, from one subject or several."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from telepulse.experiment.estimates import Proportion
from telepulse.experiment.interval import error_share
from telepulse.experiment.log import Answered, Log, LogError
from telepulse.experiment.psychometric import Errors
from telepulse.experiment.session import Kind
from telepulse.experiment.trials import Trial

# The paper asked whether it was felt "close to a direct touch".
CLOSE = 4


@dataclass(frozen=True, slots=True)
class Outcome:
    """An answered trial."""

    subject: str
    trial: Trial
    answered: Answered

    @property
    def correct(self) -> bool:
        """Whether X was named rightly; of no meaning in a catch trial."""
        return self.answered.answer == self.trial.x

    @property
    def rating(self) -> int:
        """1 to 5."""
        return int(self.answered.answer)

    @property
    def errors(self) -> Errors:
        """Aligned force errors of A, B and X as shares of the pulse; NaN of what was not felt."""
        played = self.answered.played
        return Errors(*(error_share(played, letter) for letter in ("A", "B", "X")))

    def force_mn(self, on_link: bool, field: str) -> float:
        """Mean force error of the intervals over the link, or of the direct ones, in mN."""
        values = [
            getattr(p, field)
            for p in self.answered.played
            if p.on_link is on_link and getattr(p, field) is not None
        ]
        return 1e3 * float(np.mean(values)) if values else float("nan")


@dataclass(frozen=True, slots=True)
class Results:
    """All outcomes, in order, and the conditions in the order of the session file."""

    kind: Kind
    title: str
    conditions: tuple[str, ...]
    subjects: tuple[str, ...]
    outcomes: tuple[Outcome, ...]
    asked: int

    def of(self, condition: str | None) -> list[Outcome]:
        """A condition's outcomes; None: those of catch trials."""
        return [o for o in self.outcomes if o.trial.condition == condition]

    @property
    def tested(self) -> list[Outcome]:
        """All but catch trials."""
        return [o for o in self.outcomes if o.trial.condition is not None]

    def by_condition(self) -> Iterator[tuple[str, list[Outcome]]]:
        """The conditions that were answered."""
        return ((name, found) for name in self.conditions if (found := self.of(name)))


def gather(logs: Sequence[Log]) -> Results:
    """Of sessions that have the same kind and conditions. Raises LogError."""
    first = logs[0]
    names = [log.path.stem for log in logs]
    for log in logs[1:]:
        mine, theirs = log.session, first.session
        if (mine.kind, mine.conditions) != (theirs.kind, theirs.conditions):
            raise LogError(f"{log.path}: other conditions than in {first.path}; report them apart")
    outcomes = tuple(
        Outcome(name, log.header.trials[answered.index], answered)
        for name, log in zip(names, logs, strict=True)
        for answered in log.answered
    )
    if not any(o.trial.condition is not None for o in outcomes):
        raise LogError(f"{first.path}: no trial of a condition is answered yet")
    return Results(
        kind=first.session.kind,
        title=first.session.title or first.path.stem,
        conditions=tuple(condition.name for condition in first.session.conditions),
        subjects=tuple(dict.fromkeys(names)),
        outcomes=outcomes,
        asked=sum(len(log.header.trials) for log in logs),
    )


def correct(outcomes: Iterable[Outcome]) -> Proportion:
    """How many were named rightly."""
    hits = [o.correct for o in outcomes]
    return Proportion(sum(hits), len(hits))


def close(outcomes: Iterable[Outcome]) -> Proportion:
    """How many were rated close to a direct touch, or the same."""
    hits = [o.rating >= CLOSE for o in outcomes]
    return Proportion(sum(hits), len(hits))
