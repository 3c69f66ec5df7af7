"""The project's bars on the playout estimator at its defaults, mostly on shorter traces."""

import math

import pytest

from display_node.reception.playout import DelayEstimator
from telepulse.reports.studies.playout_links import (
    BURSTS,
    best_constant_ms,
    best_moving,
    make_trace,
)
from telepulse.reports.studies.playout_rules import play
from telepulse.reports.studies.playout_scores import CONSTANT, TARGETS

# A third of the study's; bursts come every 12 s, and need all of it.
SECONDS, BURSTS_SECONDS = 100.0, 300.0
LATE = 0.01
# Not tuned to 1 % late, as the study does: a tenth more may be late. The bars have no margin.
MOST_LATE = 1.1 * LATE


@pytest.mark.parametrize(("link", "optimum", "bar"), TARGETS)
def test_our_delay_at_its_default_is_within_the_bar(link: str, optimum: str, bar: float) -> None:
    trace = make_trace(link, BURSTS_SECONDS if link == BURSTS else SECONDS)
    delay_ms = trace.delay_ns / 1e6
    constant = optimum == CONSTANT
    best_ms = best_constant_ms(delay_ms, LATE) if constant else best_moving(delay_ms, LATE).bound_ms
    played = play(DelayEstimator(LATE, max_slew=math.inf), trace)
    assert played.late < MOST_LATE
    assert played.delay_ms <= bar * best_ms
