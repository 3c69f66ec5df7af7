"""How fast a sampled loop must run to be stable: eq 22 held over a tick, the PID's derivative a
backward difference."""

import numpy as np
from scipy import signal

from telepulse.reports.paper import numbers
from telepulse.reports.paper.numbers import Gains
from telepulse.reports.paper.readings import FILM_MV, UnitReading

# Between these, every loop here turns from unstable to stable once, as the rate grows.
SLOWEST_HZ, FASTEST_HZ = 100.0, 20_000.0
TOLERANCE_HZ = 0.01


def spectral_radius(
    rate_hz: float,
    gains: Gains,
    filter_rad_per_s: float | None = None,
    delay_ticks: int = 0,
    reading: UnitReading = FILM_MV,
) -> float:
    """Largest magnitude of the sampled closed loop's poles; below 1 it is stable.

    Plant by the exact zero-order hold, sampled at each tick's begin; integral and derivative by
    backward Euler. filter_rad_per_s: N of the derivative's first-order filter N / (s + N), None
    for a pure difference. delay_ticks: extra samples between measuring and acting.
    """
    plant, tick_s = numbers.ACTUATOR, 1 / rate_hz
    continuous = np.array([1.0]), np.array([plant.m, plant.c, plant.k])
    held = signal.cont2discrete(continuous, tick_s, method="zoh")
    plant_num, plant_den = np.ravel(held[0]), held[1]
    filter_s = 0.0 if filter_rad_per_s is None else 1 / filter_rad_per_s
    kept = filter_s / (filter_s + tick_s)
    rises, forgets = np.array([1.0, -1.0]), np.array([1.0, -kept])
    proportional = gains.kp * np.polymul(rises, forgets)
    integral = gains.ki * tick_s * np.polymul([1.0, 0.0], forgets)
    derivative = gains.kd / (filter_s + tick_s) * np.polymul(rises, rises)
    pid = reading.per_newton * (proportional + integral + derivative)
    delayed = np.polymul(np.polymul(rises, forgets), [1.0] + [0.0] * delay_ticks)
    loop = np.polyadd(np.polymul(delayed, plant_den), np.polymul(pid, plant_num))
    return float(np.abs(np.roots(loop)).max())


def least_rate_hz(
    gains: Gains, filter_rad_per_s: float | None = None, delay_ticks: int = 0
) -> float:
    """The sampling rate in Hz above which the loop (error in mV by eq 21) is stable."""
    slow, fast = SLOWEST_HZ, FASTEST_HZ
    while fast - slow > TOLERANCE_HZ:
        middle = (slow + fast) / 2
        if spectral_radius(middle, gains, filter_rad_per_s, delay_ticks) < 1:
            fast = middle
        else:
            slow = middle
    return fast
