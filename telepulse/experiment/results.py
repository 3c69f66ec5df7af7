"""Results of logs: answers by condition, from one subject or several."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from telepulse.experiment.interval import error_share
from telepulse.experiment.log import Answered, Log, LogError
from telepulse.experiment.psychometrics import IntervalErrors, Proportion
from telepulse.experiment.session import Kind, Trial

# The paper asked whether it was felt "close to a direct touch".
CLOSE = 4


@dataclass(frozen=True, slots=True)
class ConditionOutcome:
    """An answered trial."""

    subject: str
    trial: Trial
    answered: Answered

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
    outcomes: tuple[ConditionOutcome, ...]
    asked: int
    spoilt: tuple[ConditionOutcome, ...] = ()
    pooled: bool = False
    who: str = "a person"
    thresholds: tuple[float, ...] = ()
    versions: tuple[str, ...] = ()

    def of(self, condition: str | None) -> list[ConditionOutcome]:
        """A condition's outcomes; None: those of catch trials."""
        return [o for o in self.outcomes if o.trial.condition == condition]

    @property
    def tested(self) -> list[ConditionOutcome]:
        """All but catch trials."""
        return [o for o in self.outcomes if o.trial.condition is not None]

    def by_condition(self) -> Iterator[tuple[str, list[ConditionOutcome]]]:
        """The conditions that were answered."""
        return ((name, found) for name in self.conditions if (found := self.of(name)))


def gather(logs: Sequence[Log], with_spoilt: bool = False) -> SessionResults:
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
        ConditionOutcome(name, log.header.trials[answered.index], answered)
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


def _difference(log: Log, first: Log) -> str:
    """Return how a log differs from the first so that they cannot be pooled, "" where not."""
    if log.header.subject != first.header.subject:
        return f"answered by {log.header.subject}, {first.path} by {first.header.subject}"
    if log.header.tables.get("scene") != first.header.tables.get("scene"):
        return f"another scene than in {first.path}"
    mine, theirs = (each.session.model_dump() for each in (log, first))
    differing = [key for key in mine if key not in FREE_KEYS and mine[key] != theirs[key]]
    return f"another {', '.join(differing)} than in {first.path}" if differing else ""


def _version(log: Log) -> str:
    """Return the version that wrote a log, with its commit where it is known."""
    commit = log.header.provenance.get("commit")
    return f"{log.header.version} ({commit})" if commit else log.header.version


def correct(outcomes: Iterable[ConditionOutcome]) -> Proportion:
    """Return the proportion named rightly."""
    hits = [o.correct for o in outcomes]
    return Proportion(sum(hits), len(hits))


def close(outcomes: Iterable[ConditionOutcome]) -> Proportion:
    """Return the proportion rated close to a direct touch, or the same."""
    hits = [o.rating >= CLOSE for o in outcomes]
    return Proportion(sum(hits), len(hits))
