"""Results of one session: by condition, what was answered, with exact intervals."""

from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table
from scipy.stats import binomtest

from protocol.config.quantities import count_text
from telepulse.experiment.log import AnsweredTrial, SessionLog

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
