import math

import pytest

from display_node.plant.second_order import SecondOrder
from telepulse.paper.explicit_loop import least_rate_hz
from telepulse.paper.published import ACTUATOR, EXPERIMENT, FILM_MV, SIMULATION, Gains

CASES: list[tuple[Gains, float | None, int, float]] = [
    (SIMULATION, None, 0, 2066),
    (EXPERIMENT, None, 0, 440),
    (SIMULATION, 100.0, 0, 3224),
    (EXPERIMENT, 2 * math.pi * 200, 0, 563),
    (EXPERIMENT, None, 1, 1024),
]


@pytest.mark.parametrize(("gains", "filter_rad_per_s", "delay", "rate_hz"), CASES)
def test_a_loop_stepped_by_hand_is_stable_above_the_least_rate_alone(
    gains: Gains, filter_rad_per_s: float | None, delay: int, rate_hz: float
) -> None:
    least_hz = least_rate_hz(gains, filter_rad_per_s, delay)
    assert least_hz == pytest.approx(rate_hz, abs=0.6)
    assert growth(1.01 * least_hz, gains, filter_rad_per_s, delay) < 1
    assert growth(0.99 * least_hz, gains, filter_rad_per_s, delay) > 1.2


def growth(rate_hz: float, gains: Gains, filter_rad_per_s: float | None, delay: int) -> float:
    """Largest force about 1 s after a kick, over that shortly after it."""
    tick_s = 1 / rate_hz
    filter_s = 0.0 if filter_rad_per_s is None else 1 / filter_rad_per_s
    plant = SecondOrder(ACTUATOR, tick_s)
    outputs = [1.0] + [0.0] * delay
    last = integral = derivative = 0.0
    forces_n = []
    for _ in range(round(1.2 * rate_hz)):
        plant.step(outputs.pop(0))
        forces_n.append(abs(plant.force_n))
        error = -FILM_MV.per_newton * plant.force_n
        integral += gains.ki * tick_s * error
        rise = gains.kd * (error - last)
        derivative = (filter_s * derivative + rise) / (filter_s + tick_s)
        last = error
        outputs.append(gains.kp * error + integral + derivative)
    tenth = round(0.1 * rate_hz)
    return max(forces_n[-tenth:]) / max(forces_n[tenth : 2 * tenth])
