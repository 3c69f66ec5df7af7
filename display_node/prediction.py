"""Prediction: what the pulse is where no sample has arrived yet."""

from collections.abc import Callable

Predictor = Callable[[list[int], list[float], int], float]
"""(times_ns, values of the newest samples, oldest first; instant_ns after them) → value."""

SLOPE_WINDOW_NS = 10_000_000
SLOPE_REACH_NS = 20_000_000


def hold(times_ns: list[int], values: list[float], instant_ns: int) -> float:
    """The newest value."""
    return values[-1]


def linear(times_ns: list[int], values: list[float], instant_ns: int) -> float:
    """The newest value carried on by the slope of the last 10 ms, for at most 20 ms."""
    start = len(times_ns) - 1
    while start > 0 and times_ns[-1] - times_ns[start - 1] <= SLOPE_WINDOW_NS:
        start -= 1
    span_ns = times_ns[-1] - times_ns[start]
    if not span_ns:
        return values[-1]
    slope = (values[-1] - values[start]) / span_ns
    return values[-1] + slope * min(instant_ns - times_ns[-1], SLOPE_REACH_NS)


PREDICTORS: dict[str, Predictor] = {"hold": hold, "linear": linear}
