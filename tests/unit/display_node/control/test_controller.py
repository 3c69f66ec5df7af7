import math

import pytest

from display_node.control.controller import ControllerScene, StepperController
from display_node.plant.contact import ContactLaw
from display_node.plant.film import FilmTable
from display_node.plant.stepper import StepperScene

TICK_S = 1e-3
LAW = ContactLaw(5e-3, 0.05e9 / 0.75, 1e3)
STEPPER = StepperScene.model_validate({"kind": "stepper", "max_speed": "1e15 m/s"})


def controller(**table: object) -> StepperController:
    scene = ControllerScene.model_validate({"kp": 0} | table)
    return StepperController(scene, STEPPER, LAW, FilmTable(), 2.5, TICK_S)


MILLIVOLTS_PER_NEWTON = 1e3 * 0.3 / (2 * math.pi * 9e-3)


@pytest.mark.parametrize(
    ("error", "expected", "response"),
    [
        ("force", 0.5 - 0.3, TICK_S * LAW.stiffness(0.3)),
        (
            "millivolts",
            (0.5 - 0.3) * MILLIVOLTS_PER_NEWTON,
            TICK_S * LAW.stiffness(0.3) * MILLIVOLTS_PER_NEWTON,
        ),
        ("position", LAW.position(0.5) - LAW.position(0.3), TICK_S),
    ],
)
def test_the_error_is_taken_in_its_kind(error: str, expected: float, response: float) -> None:
    under_test = controller(kp=2, error=error)
    output = under_test.output([0.9, 0.5], 0.3)
    # What is left of the error when the tick is over is what the gain acts on.
    assert output == pytest.approx(2 * (expected - response * output))


def test_millivolts_by_eq_21_are_5305_a_newton() -> None:
    # Where nothing touches there is no stiffness, and the law is explicit.
    under_test = controller(kp=1, error="millivolts")
    assert under_test.output([1.0, 1.0], 0.0) == pytest.approx(5305, abs=0.5)


@pytest.mark.parametrize("error", ["force", "millivolts", "position"])
def test_no_error_is_no_output(error: str) -> None:
    under_test = controller(kp=100, ki=10, kd=1, error=error)
    for _ in range(10):
        assert under_test.output([0.4, 0.4], 0.4) == pytest.approx(0, abs=1e-9)


def test_feed_forward_is_the_references_own_speed() -> None:
    under_test = controller(kp=100, error="position", feed_forward=True)
    wanted = (LAW.position(0.35) - LAW.position(0.3)) / TICK_S
    assert under_test.output([0.3, 0.35], 0.3) == pytest.approx(wanted, abs=1e-9)


def test_without_feed_forward_only_the_error_at_the_ticks_end_counts() -> None:
    under_test = controller(kp=100, error="position")
    assert under_test.output([0.9, 0.3], 0.3) == pytest.approx(0, abs=1e-9)
