"""How many trials it takes, as tables."""

from telepulse.experiment.psychometrics import (
    PAPER,
    d_prime,
    hits_needed,
    power,
    trials_needed,
)
from telepulse.reports.document import Chapter, Report, Table

SHARES = (0.55, 0.6, 2 / 3, 0.75, 0.8, 0.9, 0.95)
COUNTS = (6, 10, 16, 20, 32, 50, 100)
POWERS = (0.8, 0.9)


def build_plan() -> Report:
    """The tables, from exact binomial sums."""
    return Report("How many trials", (Chapter("Trials", (), (_needed(), _counts())),))


def percent(share: float) -> str:
    """As the tables have it."""
    return f"{100 * share:.3g} %"


def _needed() -> Table:
    rows = tuple(
        (
            percent(share),
            f"{d_prime(share):.2f}",
            *(_or_more(trials_needed(share, wanted)) for wanted in POWERS),
        )
        for share in SHARES
    )
    return Table(
        "Trials that a subject needs to pass for more than guessing, p ≤ 5 %",
        ("right", "d'", "4 times of 5", "9 times of 10"),
        rows,
        "ABX, one-sided exact binomial test; from these numbers on it is never less often.",
    )


def _or_more(trials: int | None) -> str:
    return "more than 5000" if trials is None else str(trials)


def _counts() -> Table:
    rows = tuple(
        (
            str(trials),
            f"{hits_needed(trials)}" if hits_needed(trials) <= trials else "none",
            *(percent(power(trials, share)) for share in (PAPER.share, 0.75, 0.9)),
        )
        for trials in COUNTS
    )
    return Table(
        "What a number of trials can show",
        ("trials", "right for p ≤ 5 %", "passes at 2/3", "at 3/4", "at 9/10"),
        rows,
        "How often somebody who is right so often passes. The paper had six.",
    )
