"""PID with a filtered derivative and anti-windup, stable at any tick length.

The law is integrated by backward Euler and solved together with the actuator's next step. It uses
the error at the end of the tick, which the actuator's model predicts as an affine function of the
output. With a backward-difference derivative, the gains of Dargahi et al. (2008) diverge at 1 kHz;
here they are stable at every rate (decision 7).
"""

import math


class Pid:
    """PID whose output is within ±limit.

    The integral is held while the output is at its bound and the error would push it further
    (anti-windup by conditional integration).

    Parameters
    ----------
    kp, ki, kd
        Gains: output per unit of the error, of its integral in s, and of its slope in 1/s.
    derivative_filter_hz
        Corner of the derivative's low-pass in Hz.
    tick_s
        Length of a tick in s.
    limit
        Greatest magnitude of the output.
    dead_band
        An error within ±dead_band counts as 0.
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
        self._remembers = bool(ki or kd)
        # A term whose gain is 0 is left out: it would add a pole at 1 to the linearised loop.
        derivative = ("_derivative", "_last_error") if kd else ()
        self.STATE: tuple[str, ...] = (*derivative, "_integral") if ki else derivative

    def step(
        self,
        error: float,
        error_drop_per_output: float = 0.0,
        feed_forward: float = 0.0,
        lower: float = -math.inf,
        upper: float = math.inf,
    ) -> float:
        """Return the output to hold for a tick.

        Parameters
        ----------
        error
            Error at the tick's end if the output is 0. NaN or infinity returns −limit, which
            retracts the tip.
        error_drop_per_output
            Decrease of that error per unit of output; 0, if unknown, makes the law explicit.
        feed_forward
            Feed-forward, added to the output before the bounds.
        lower, upper
            Bounds of this tick's output, besides the limit.
        """
        if not math.isfinite(error):
            return -self._limit
        fed_error = error - error_drop_per_output * feed_forward
        if -self._dead_band <= fed_error <= self._dead_band:
            error, fed_error = error_drop_per_output * feed_forward, 0.0
        last, past = error, 0.0
        if self._remembers:
            last = error if self._last_error is None else self._last_error
            past = self._integral + self._keep * self._derivative - self._kd_tick * last
        wanted = feed_forward + (self._gain * fed_error + past) / (
            1 + error_drop_per_output * self._gain
        )
        # Comparisons, and no calls of `min` and `max`: this runs each tick.
        limit = self._limit
        highest = upper if upper < limit else limit
        lowest = lower if lower > -limit else -limit
        # NaN (an overflow) becomes the lower bound.
        output = wanted if wanted > lowest else lowest
        if output > highest:
            output = highest
        if not self._remembers:
            return output
        remaining = error - error_drop_per_output * output
        if output == wanted or (error > 0) != (wanted > output):
            self._integral += self._ki_tick * remaining
        if self._kd_tick:
            change = self._kd_tick * (remaining - last)
            self._derivative = self._keep * self._derivative + change
            self._last_error = remaining
        return output
