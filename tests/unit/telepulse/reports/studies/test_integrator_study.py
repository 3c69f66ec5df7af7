import math

import pytest

from telepulse.paper.explicit_loop import Step
from telepulse.reports.studies.integrator_report import ROUNDING, beaten_by, verdict
from telepulse.reports.studies.integrator_scores import IntegratorPoint, costs_us

FAST = IntegratorPoint("fast", "fast", 1e-3, 0.1)
MIDDLE = IntegratorPoint("middle", "middle × 2", 1e-6, 1.0)
EXACT = IntegratorPoint("exact", "exact", 1e-16, 10.0)
WORSE = IntegratorPoint("worse", "worse", 1e-5, 2.0)


def test_the_frontier_is_what_no_other_point_beats() -> None:
    points = [FAST, WORSE, EXACT, MIDDLE]
    assert [point for point in points if not beaten_by(point, points)] == [FAST, EXACT, MIDDLE]
    assert beaten_by(WORSE, points) == [MIDDLE]


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        # Errors at rounding are equal, so that only speed counts.
        (EXACT, IntegratorPoint("slower", "slower", ROUNDING * 1e-3, 11.0)),
        # At equal cost the more accurate wins.
        (MIDDLE, IntegratorPoint("coarser", "coarser", 1e-5, MIDDLE.cost_us)),
        (FAST, IntegratorPoint("diverged", "diverged", math.inf, 0.5)),
    ],
)
def test_one_of_two_points_beats_the_other(better: IntegratorPoint, worse: IntegratorPoint) -> None:
    assert beaten_by(worse, [better, worse]) == [better]
    assert beaten_by(better, [better, worse]) == []


@pytest.mark.parametrize(
    "other",
    [
        IntegratorPoint("twin", "twin", MIDDLE.error, MIDDLE.cost_us),
        IntegratorPoint("diverged", "diverged", math.inf, 0.5),
    ],
)
def test_equal_and_faster_points_are_not_beaten(other: IntegratorPoint) -> None:
    assert beaten_by(MIDDLE, [MIDDLE, other]) == beaten_by(other, [MIDDLE, other]) == []


def test_the_verdict_names_better_points() -> None:
    assert "fast, is on the frontier: of the other 3 rows" in verdict([FAST, MIDDLE, WORSE, EXACT])
    sentence = verdict([WORSE, FAST, MIDDLE])
    assert sentence == "The default, worse, is not on the frontier; it is beaten by: middle × 2."


def test_every_stepper_plays_the_same_voltages_anew_each_round() -> None:
    played: dict[str, list[float]] = {}

    def make(name: str) -> Step[float]:
        played[name] = []
        return lambda volts: played[name].append(volts) or volts

    costs = costs_us([lambda: make("first"), lambda: make("second")], [1.0, 2.0, 3.0], rounds=2)
    assert len(costs) == 2
    assert all(cost > 0 for cost in costs)
    for voltages in played.values():
        assert voltages[:3] == [1.0, 2.0, 3.0]
        assert len(voltages) % 3 == 0


def test_a_cost_is_that_of_one_step() -> None:
    now_s = iter([0.0, 0.5, 10.0, 13.0, 20.0, 21.0])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("time.process_time", lambda: next(now_s))
        costs = costs_us([lambda: lambda volts: volts], [0.0] * 100, rounds=3)
    assert costs == [pytest.approx(1.0 / 100 * 1e6)]
