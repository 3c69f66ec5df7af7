"""Integration methods on a rotor that resonates at 100 Hz, voltages held over ticks of 1 ms."""

import math
from collections.abc import Callable
from decimal import Decimal, localcontext

import numpy as np
import pytest
from scipy.linalg import expm

from benchmarks.integrators import Point, beaten_by
from benchmarks.integrators.steppers import (
    Plant,
    decimals,
    exact_hold,
    explicit_euler,
    held_matrix,
    largest_error,
    rk4,
    semi_implicit_euler,
)
from telepulse.paper.explicit_loop import Step

TICK_S = 1e-3
OMEGA = 2 * math.pi * 100
ROTOR = Plant(1.0, 2 * 0.2 * OMEGA, OMEGA**2)
VOLTAGES = (OMEGA**2 * np.random.default_rng(4).normal(0, 1, 60)).tolist()


@pytest.mark.parametrize("tick_s", [1e-4, 1e-2])
def test_the_held_matrix_is_the_exponential(tick_s: float) -> None:
    system = np.array([[0, 1, 0], [-ROTOR.k, -ROTOR.c, 1], [0, 0, 0]]) * tick_s
    held = np.array(held_matrix(ROTOR, tick_s), dtype=float)
    assert held == pytest.approx(expm(system), rel=1e-11, abs=1e-14)


@pytest.mark.parametrize(
    ("stepper", "order", "substeps"),
    [(explicit_euler, 1, 256), (semi_implicit_euler, 1, 256), (rk4, 4, 16)],
)
def test_each_doubling_of_sub_steps_gains_the_order_in_bits(
    stepper: Callable[[Plant[float], float, int], Step[float]], order: int, substeps: int
) -> None:
    with localcontext(prec=40):
        truth = list(map(exact_hold(ROTOR, TICK_S), decimals(VOLTAGES)))
    errors = [
        largest_error(decimals(map(stepper(ROTOR, TICK_S, n), VOLTAGES)), truth)
        for n in (substeps, 2 * substeps, 4 * substeps)
    ]
    assert -np.diff(np.log2(errors)) == pytest.approx([order, order], abs=0.05)


def test_a_trajectory_beyond_floats_has_an_infinite_error() -> None:
    grown = decimals(map(explicit_euler(ROTOR, 1.0, 1), [1.0] * 200))
    assert largest_error(grown, [Decimal(0)] * 200) == math.inf


def test_the_frontier_is_what_no_other_point_beats() -> None:
    fast, middle, exact, slower, worse = (
        Point(name, error, cost_us)
        for name, error, cost_us in (
            ("fast", 1e-3, 0.1),
            ("middle", 1e-6, 1.0),
            ("exact", 1e-16, 10.0),
            # Errors at rounding are equal, so that only speed counts.
            ("slower", 1e-17, 11.0),
            ("worse", 1e-5, 2.0),
        )
    )
    points = [fast, worse, exact, slower, middle]
    assert [point for point in points if not beaten_by(point, points)] == [fast, exact, middle]
    assert beaten_by(worse, points) == [middle]
