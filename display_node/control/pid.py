"""PID with a filtered derivative and anti-windup, stable at any tick.

Backward Euler throughout, solved together with the actuator's own next step: the law acts on the
error at the tick's end, which the actuator's model gives as a straight line in the output. So the
paper's gains, which diverge at 1 kHz with a backward-difference derivative, are stable at every
rate (decision 7).
"""

import math


class Pid:
    """PID whose output is within ±limit.

    The integral is held while the output is at its bound and the error would push it further
    (anti-windup by conditional integration).

    Parameters
    ----------
    kp, ki, kd
        Gains: output for each unit of the error, of its integral over s, of its slope per s.
    derivative_filter_hz
        Corner of the derivative's low-pass in Hz.
    limit
        Greatest magnitude of the output.
    dead_band
        An error within ±this counts as none.
    """

    def __init__(
        self,
        kp: float,
        ki: float,
        kd: float,
        derivative_filter_hz: float,
        tick_s: float,
        limit: float,
        dead_band: float = 0.0,
    ) -> None:
        filter_s = 1 / (2 * math.pi * derivative_filter_hz)
        self._ki_tick = ki * tick_s
        self._keep = filter_s / (filter_s + tick_s)
        self._kd_tick = kd / (filter_s + tick_s)
        self._gain = kp + self._ki_tick + self._kd_tick
        self._limit = limit
        self._dead_band = dead_band
        self._integral = 0.0
        self._derivative = 0.0
        self._last_error: float | None = None
        # What nothing feeds is no state: it would be a pole at 1.
        derivative = ("_derivative", "_last_error") if kd else ()
        self.STATE: tuple[str, ...] = (*derivative, "_integral") if ki else derivative

    def step(
        self,
        error: float,
        response: float = 0.0,
        feed: float = 0.0,
        least: float = -math.inf,
        most: float = math.inf,
    ) -> float:
        """Return the output to hold for a tick.

        Parameters
        ----------
        error
            Error at the tick's end if the output is 0. No finite number gives −limit: retract.
        response
            Part of the error that an output of 1 takes away by then; 0 where it is not known,
            which makes the law explicit.
        feed
            Feed-forward, added to the output before the bounds.
        least, most
            Bounds of this tick's output, besides the limit.
        """
        if not math.isfinite(error):
            return -self._limit
        unfed = error - response * feed
        if -self._dead_band <= unfed <= self._dead_band:
            error, unfed = response * feed, 0.0
        last = error if self._last_error is None else self._last_error
        past = self._integral + self._keep * self._derivative - self._kd_tick * last
        wanted = feed + (self._gain * unfed + past) / (1 + response * self._gain)
        limit = self._limit
        highest = limit if limit < most else most
        lowest = -limit if -limit > least else least
        if lowest <= wanted <= highest:
            output, free = wanted, True
        else:
            output = highest if wanted > highest else lowest
            free = (error > 0) != (wanted > output)
        remaining = error - response * output
        if free:
            self._integral += self._ki_tick * remaining
        if self._kd_tick:
            change = self._kd_tick * (remaining - last)
            self._derivative = self._keep * self._derivative + change
            self._last_error = remaining
        return output
