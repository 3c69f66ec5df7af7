import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from display_node.plant.contact import ContactLaw
from display_node.plant.scene import StepperScene
from protocol.tactile import ElasticLayer

REDUCED_PA = 0.05e9 / 0.75
FINGER = ContactLaw(5e-3, REDUCED_PA, 1e3)
RIGID_STOP = ContactLaw(5e-3, REDUCED_PA, math.inf)
LAWS = {
    "finger": FINGER,
    "rigid stop": RIGID_STOP,
    "hard finger": ContactLaw(1e-3, 1e6, 1e6),
    "soft finger": ContactLaw(10e-3, 1e9, 10.0),
    "soft rubber": ContactLaw(5e-3, 1e3, 1e3),
}
every_law = pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())


@every_law
@settings(deadline=None)
@given(exponent=st.floats(-12, 2))
def test_force_and_position_are_inverse(law: ContactLaw, exponent: float) -> None:
    value = 10**exponent
    assert law.force(law.position(value)) == pytest.approx(value, rel=1e-11)
    if value <= 1 and law.force(value) < 1e6:
        assert law.position(law.force(value)) == pytest.approx(value, rel=1e-11)


def test_a_rigid_stop_is_hertz_alone() -> None:
    stiffness = 4 / 3 * REDUCED_PA * math.sqrt(5e-3)
    for position_m in (1e-6, 1e-5, 1e-4):
        assert RIGID_STOP.force(position_m) == pytest.approx(stiffness * position_m**1.5)


def test_the_finger_yields_in_series_with_the_rubber() -> None:
    for force_n in (0.01, 0.5, 2.5):
        expected_m = RIGID_STOP.position(force_n) + force_n / 1e3
        assert FINGER.position(force_n) == pytest.approx(expected_m)


def stepper(lead_mm: int, fingertip: str) -> tuple[ContactLaw, float]:
    scene = StepperScene.model_validate(
        {"kind": "stepper", "lead": f"{lead_mm} mm", "fingertip": fingertip}
    )
    return scene.contact(ElasticLayer()), scene.step_m


@pytest.mark.parametrize(
    ("fingertip", "lead_mm", "microstep_n"),
    [
        ("1000000000 N/mm", 1, 12.7e-3), ("1000000000 N/mm", 2, 25.3e-3),
        ("1000000000 N/mm", 6, 76e-3), ("1 N/mm", 1, 0.30e-3), ("1 N/mm", 2, 0.61e-3),
        ("1 N/mm", 6, 1.8e-3),
    ],
)  # fmt: skip
def test_a_microsteps_force_at_half_a_newton(
    fingertip: str, lead_mm: int, microstep_n: float
) -> None:
    law, step_m = stepper(lead_mm, fingertip)
    assert law.stiffness(0.5) * step_m == pytest.approx(microstep_n, rel=0.02)


@every_law
@pytest.mark.parametrize("value", [0.0, -0.0, -1e-300, -1.0, -math.inf])
def test_without_touch_force_and_position_are_zero(law: ContactLaw, value: float) -> None:
    assert law.force(value) == 0.0
    assert law.position(value) == 0.0


@every_law
@pytest.mark.parametrize("tiny", [5e-324, 1e-310, 1e-200])
def test_the_smallest_numbers_are_accepted(law: ContactLaw, tiny: float) -> None:
    assert 0 < law.position(tiny) < 1e-12
    assert 0 <= law.force(tiny) < 1e-12
    assert law.force(law.position(1e-200)) == pytest.approx(1e-200)
    assert ContactLaw(5e-3, 1e-6, 1e3).force(5e-324) == 0.0
