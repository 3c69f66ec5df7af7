"""The paper's gains over tick rates: the explicit PID beside the one that the display ships."""

import math
from dataclasses import dataclass

import numpy as np

from display_node.control.controller import ControllerScene
from display_node.control.linear_loop import linear_loop
from display_node.control.margins import margins
from display_node.plant.second_order import SecondOrder
from protocol.errors import SceneError
from telepulse.reports.paper import numbers
from telepulse.reports.paper.numbers import Gains
from telepulse.reports.paper.pulse import beats
from telepulse.reports.paper.readings import FILM_MV
from telepulse.reports.paper.sampling import spectral_radius
from telepulse.reports.paper.stability import BOUND_N, HELD_N, Array, Setup, refusal

RATES_HZ = (100.0, 200.0, 500.0, 1_000.0, 2_000.0, 5_000.0, 10_000.0)
GAINS = {"simulation": numbers.SIMULATION, "experiment": numbers.EXPERIMENT}
# Of the display's scene, and so far above every tick rate that there is none.
FILTERS_HZ = (200.0, 100_000.0)
SECONDS = 2.0
SETTLING_S = 1.0
PEAK_TO_PEAK_N = 0.3
FREQUENCIES = 400


@dataclass(frozen=True, slots=True)
class Sampled:
    """One gain set at one tick rate.

    explicit_radius, shipped_radius: largest poles, stable below 1; explicit_n, shipped_n,
    late_n: force RMSE in N of the explicit loop, of the shipped one and of the shipped one whose
    film is read a tick late, ∞ where it diverged; delay_ticks: the shipped loop's delay margin;
    refused: why the display would not run it, or None.
    """

    gains: str
    filter_hz: float
    rate_hz: float
    explicit_radius: float
    shipped_radius: float
    explicit_n: float
    shipped_n: float
    late_n: float
    delay_ticks: float
    refused: str | None


def sampled(name: str, filter_hz: float, rate_hz: float) -> Sampled:
    """Run one gain set at one rate, on the paper's pulse with the error in mV by eq 21."""
    gains, tick_s = GAINS[name], 1 / rate_hz
    # From the pulse's foot at rest, or the slow mode of a small ki outlasts the run.
    shape = beats("paper", rate_hz, SECONDS)
    wanted_n = PEAK_TO_PEAK_N * (shape - shape[0])
    loop = papers(gains, filter_hz, tick_s)
    linear = linear_loop(loop.controller, loop.actuator, loop.layer, loop.film, tick_s, HELD_N)
    found = margins(linear, FREQUENCIES)
    try:
        shipped_n, late_n = (_shipped(loop, wanted_n, late) for late in (False, True))
        refused = None
    except SceneError as error:
        shipped_n = late_n = math.inf
        refused = refusal(error)
    return Sampled(
        name,
        filter_hz,
        rate_hz,
        spectral_radius(rate_hz, gains, 2 * math.pi * filter_hz),
        found.pole_radius,
        _explicit(gains, filter_hz, wanted_n, tick_s),
        shipped_n,
        late_n,
        found.delay_s / tick_s,
        refused,
    )


def measure() -> tuple[Sampled, ...]:
    """Both gain sets, with and without a filter, at every rate."""
    return tuple(
        sampled(name, filter_hz, rate_hz)
        for name in GAINS
        for filter_hz in FILTERS_HZ
        for rate_hz in RATES_HZ
    )


def papers(gains: Gains, filter_hz: float, tick_s: float) -> Setup:
    """The paper's loop as the display runs it, error in mV by eq 21, on eq 22."""
    controller = ControllerScene.model_validate(
        {
            "kp": gains.kp,
            "ki": gains.ki,
            "kd": gains.kd,
            "error": "millivolts",
            "derivative_filter": f"{filter_hz} Hz",
        }
    )
    return Setup(controller, numbers.ACTUATOR, tick_s=tick_s)


def _shipped(setup: Setup, wanted_n: Array, late: bool) -> float:
    loop, reference_n = setup.loop(), wanted_n.tolist()
    reading_n, felt_n = 0.0, []
    for tick in range(len(reference_n) - 1):
        before_n, reading_n = reading_n, loop.read_film()
        loop.tick(reference_n[tick : tick + 2], before_n if late else reading_n)
        felt_n.append(loop.felt_n)
        if abs(loop.felt_n) > BOUND_N:
            return math.inf
    return _rmse_n(felt_n, wanted_n, setup.tick_s)


def _explicit(gains: Gains, filter_hz: float, wanted_n: Array, tick_s: float) -> float:
    """A PID as textbooks write it: the error of now, its derivative a backward difference."""
    plant = SecondOrder(numbers.ACTUATOR, tick_s)
    filter_s = 1 / (2 * math.pi * filter_hz)
    integral = derivative = last = 0.0
    felt_n = []
    for wanted in wanted_n.tolist()[:-1]:
        error = FILM_MV.per_newton * (wanted - plant.force_n)
        integral += gains.ki * tick_s * error
        derivative = (filter_s * derivative + gains.kd * (error - last)) / (filter_s + tick_s)
        last = error
        felt_n.append(plant.step(gains.kp * error + integral + derivative))
        if abs(plant.force_n) > BOUND_N:
            return math.inf
    return _rmse_n(felt_n, wanted_n, tick_s)


def _rmse_n(felt_n: list[float], wanted_n: Array, tick_s: float) -> float:
    error_n = (np.array(felt_n) - wanted_n[1:])[round(SETTLING_S / tick_s) :]
    return float(np.sqrt(np.mean(error_n**2)))
