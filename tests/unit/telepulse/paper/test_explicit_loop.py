import math

import numpy as np
import pytest

from display_node.plant.second_order import SecondOrder
from telepulse.paper.explicit_loop import close_loop, least_rate_hz, spectral_radius
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


def test_at_1_khz_the_simulations_gains_are_unstable_and_the_experiments_with_a_delay() -> None:
    assert spectral_radius(1000, SIMULATION) > 1.4
    assert spectral_radius(1000, EXPERIMENT) < 1 < spectral_radius(1000, EXPERIMENT, delay_ticks=1)


def test_a_constant_error_gives_the_three_terms_of_table_5() -> None:
    tick_s, error_n, filter_s = 1e-3, 0.002, 1 / (2 * math.pi * 200)
    _, voltages = close_loop(lambda _: 0.0, tick_s, [error_n] * 5)
    for ticks, volts in enumerate(voltages, 1):
        fading = (filter_s / (filter_s + tick_s)) ** (ticks - 1) / (filter_s + tick_s)
        factor = EXPERIMENT.kp + EXPERIMENT.ki * tick_s * ticks + EXPERIMENT.kd * fading
        assert volts == pytest.approx(factor * FILM_MV.per_newton * error_n, rel=1e-12)
    assert pytest.approx(5305, abs=0.5) == FILM_MV.per_newton


@pytest.mark.parametrize(("tick_s", "stable"), [(1e-4, True), (1e-3, True), (1e-2, False)])
def test_an_impulse_grows_by_the_spectral_radius_a_tick(tick_s: float, stable: bool) -> None:
    step = SecondOrder(ACTUATOR, tick_s).step
    forces_n, _ = close_loop(step, tick_s, [1.0] + [0.0] * 299)
    radius = spectral_radius(1 / tick_s, EXPERIMENT, 2 * math.pi * 200)
    assert (radius < 1) == (np.abs(forces_n[-50:]).max() < 1) == stable
    if not stable:
        early, late = (np.abs(forces_n[begin : begin + 50]).max() for begin in (50, 250))
        assert (late / early) ** (1 / 200) == pytest.approx(radius, rel=0.01)
