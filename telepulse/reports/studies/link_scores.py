"""Every link at every perceived delay with every predictor, and what a predictor costs."""

import time
from dataclasses import dataclass
from functools import partial

from display_node.prediction import PredictorName
from telepulse.reports.studies.link_play import LinkCell, LinkEffort, LinkOutcome, play, pooled
from telepulse.reports.studies.link_policies import Policies, play_policies
from telepulse.reports.studies.one_thread import in_one_thread
from telepulse.reports.studies.prediction_sets import pulses
from telepulse.reports.studies.sweep import sweep

PREDICTORS: tuple[PredictorName, ...] = ("hold", "linear", "stack")
# The prototype played an arterial recording; heartpy's first is what we have.
POLICY_SETS = ("variability", "heartpy data")
POLICY_SECONDS = 60.0
COST_ROUNDS = 2


@dataclass(frozen=True, slots=True)
class Link:
    """A link as `parse_link` reads it, and the perceived delays to try on it."""

    text: str
    delays_ms: tuple[float, ...]


LAN, NEAR, FAR = "LAN", "20 ± 3 ms, 1 % lost", "40 ± 10 ms"
BURSTS, TCP = "20 ms with bursts", "TCP, 40 ms, 1 % lost"
LINKS: dict[str, Link] = {
    LAN: Link("delay=0.5ms,jitter=0.2ms", (0, 4, 8, 12)),
    NEAR: Link("delay=20ms,jitter=3ms,loss=1%", (0, 10, 20, 30, 40)),
    FAR: Link("delay=40ms,jitter=10ms", (0, 20, 40, 60, 80)),
    BURSTS: Link("delay=20ms,jitter=10ms,jitter_kind=bursts", (0, 20, 40, 80, 120)),
    TCP: Link("delay=40ms,jitter=3ms,loss=1%,transport=tcp", (0, 40, 80, 120, 160)),
}
# By perceived delay; None: chosen by the display.
Curve = dict[float | None, LinkOutcome]


@dataclass(frozen=True, slots=True)
class LinkScores:
    """outcomes: by link and predictor; policies: by pulse; costs_us: processor time of a
    simulated millisecond, both nodes and the link, by predictor."""

    outcomes: dict[str, dict[PredictorName, Curve]]
    policies: dict[str, Policies]
    costs_us: dict[PredictorName, float]


def score_links(
    effort: LinkEffort, scheduler: str | None = None, links: dict[str, Link] = LINKS
) -> LinkScores:
    """Play everything on all cores or a Dask cluster, then take the costs here.

    Raises SweepError or SourceError.
    """
    cells = [
        LinkCell(link.text, predictor, delay_ms, seed)
        for link in links.values()
        for predictor in PREDICTORS
        for delay_ms in (*link.delays_ms, None)
        for seed in effort.seeds
    ]
    played = dict(zip(cells, sweep(partial(play, effort=effort), cells, scheduler), strict=True))

    def curve(link: Link, predictor: PredictorName) -> Curve:
        return {
            delay_ms: pooled(
                played[LinkCell(link.text, predictor, delay_ms, seed)] for seed in effort.seeds
            )
            for delay_ms in (*link.delays_ms, None)
        }

    outcomes = {
        name: {predictor: curve(link, predictor) for predictor in PREDICTORS}
        for name, link in links.items()
    }
    sets = [pulse for pulse in pulses(POLICY_SECONDS, seed=1) if pulse.name in POLICY_SETS]
    policies = sweep(partial(play_policies, link=LINKS[TCP].text), sets, scheduler)
    return LinkScores(
        outcomes,
        {pulse.name: each for pulse, each in zip(sets, policies, strict=True)},
        # Alone on the machine, once the others have ended.
        in_one_thread(costs_us, effort),
    )


def costs_us(effort: LinkEffort) -> dict[PredictorName, float]:
    """Least processor time of a millisecond of simulation in some rounds, all predicted.

    The predictors take turns, so that a busy moment of the machine falls on all alike.
    """
    taken: dict[PredictorName, list[float]] = {predictor: [] for predictor in PREDICTORS}
    for _ in range(COST_ROUNDS):
        for predictor in PREDICTORS:
            began_s = time.process_time()
            play(LinkCell(LINKS[FAR].text, predictor, 0.0), effort)
            seconds = effort.settle_seconds + effort.seconds
            taken[predictor].append((time.process_time() - began_s) / seconds * 1e3)
    return {predictor: min(each) for predictor, each in taken.items()}
