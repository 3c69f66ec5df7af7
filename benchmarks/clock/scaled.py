"""A clock with a known error, which every process of a machine can compute."""

import time

# Large enough to reveal a clock that is mistaken for another.
AHEAD_NS = 3_600_000_000_000


def scaled_ns(local_ns: int, origin_ns: int, skew_ppm: float) -> int:
    """Return the wrong clock's time when the machine's monotonic clock shows `local_ns`.

    origin_ns: time at which the wrong clock was ahead by exactly an hour.
    """
    return local_ns + AHEAD_NS + round((local_ns - origin_ns) * skew_ppm * 1e-6)


def now_ns(origin_ns: int, skew_ppm: float) -> int:
    """Return the wrong clock's present time."""
    return scaled_ns(time.perf_counter_ns(), origin_ns, skew_ppm)
