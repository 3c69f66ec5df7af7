"""The paper's loop with a textbook's explicit PID over eq 22: its poles, and its course in time.

The PID acts on the error in mV by eq 21 at the beginning of a tick. Integral and derivative are
discretised by backward Euler; the actuator holds the voltage over the tick.
"""

import math
from collections.abc import Callable, Sequence

import numpy as np
from scipy import signal

from telepulse.paper import published
from telepulse.paper.published import FILM_MV, Gains

# Between these, every loop here changes from unstable to stable once, as the rate grows.
SLOWEST_HZ, FASTEST_HZ = 100.0, 20_000.0
TOLERANCE_HZ = 0.01


def spectral_radius(
    rate_hz: float, gains: Gains, filter_rad_per_s: float | None = None, delay_ticks: int = 0
) -> float:
    """Return the largest magnitude of the loop's poles; below 1 it is stable.

    The plant is the paper's actuator (eq 22) under an exact zero-order hold.

    Parameters
    ----------
    rate_hz, gains
        Tick rate in Hz and gains of Table 5.
    filter_rad_per_s
        N of the derivative's first-order filter N / (s + N); None for a pure difference.
    delay_ticks
        Additional delay in ticks from reading the film to the command.
    """
    plant, tick_s = published.ACTUATOR, 1 / rate_hz
    continuous = np.array([1.0]), np.array([plant.m, plant.c, plant.k])
    held = signal.cont2discrete(continuous, tick_s, method="zoh")
    plant_num, plant_den = np.ravel(held[0]), held[1]
    filter_s = 0.0 if filter_rad_per_s is None else 1 / filter_rad_per_s
    kept = filter_s / (filter_s + tick_s)
    difference, filtered = np.array([1.0, -1.0]), np.array([1.0, -kept])
    proportional = gains.kp * np.polymul(difference, filtered)
    integral = gains.ki * tick_s * np.polymul([1.0, 0.0], filtered)
    derivative = gains.kd / (filter_s + tick_s) * np.polymul(difference, difference)
    pid = FILM_MV.per_newton * (proportional + integral + derivative)
    delayed = np.polymul(np.polymul(difference, filtered), [1.0] + [0.0] * delay_ticks)
    loop = np.polyadd(np.polymul(delayed, plant_den), np.polymul(pid, plant_num))
    return float(np.abs(np.roots(loop)).max())


def least_rate_hz(
    gains: Gains, filter_rad_per_s: float | None = None, delay_ticks: int = 0
) -> float:
    """Return the sampling rate in Hz above which the loop is stable."""
    slow, fast = SLOWEST_HZ, FASTEST_HZ
    while fast - slow > TOLERANCE_HZ:
        middle = (slow + fast) / 2
        if spectral_radius(middle, gains, filter_rad_per_s, delay_ticks) < 1:
            fast = middle
        else:
            slow = middle
    return fast


def close_loop(
    step: Callable[[float], float],
    tick_s: float,
    reference_n: Sequence[float],
    gains: Gains,
    filter_hz: float,
) -> list[float]:
    """Follow a reference from rest; return the force in N after each tick.

    step: the actuator, from a voltage in V to the force in N at the tick's end. filter_hz: corner
    of the derivative's filter.
    """
    filter_s, per_newton = 1 / (2 * math.pi * filter_hz), FILM_MV.per_newton
    kp, ki = gains.kp * per_newton, gains.ki * per_newton * tick_s
    kd = gains.kd * per_newton / (filter_s + tick_s)
    kept = filter_s / (filter_s + tick_s)
    force_n = integral = derivative = last_n = 0.0
    forces_n = []
    for wanted_n in reference_n:
        error_n = wanted_n - force_n
        integral += ki * error_n
        derivative = kept * derivative + kd * (error_n - last_n)
        last_n = error_n
        force_n = step(kp * error_n + integral + derivative)
        forces_n.append(force_n)
    return forces_n
