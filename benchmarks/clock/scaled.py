"""A clock that runs wrong by a known amount, and whose truth every process of a machine knows."""

import time

# A mix-up of the clocks shows.
AHEAD_NS = 3_600_000_000_000


def scaled_ns(local_ns: int, origin_ns: int, skew_ppm: float) -> int:
    """What the wrong clock shows when the machine's monotonic clock shows `local_ns`.

    origin_ns: when it was ahead by an hour and no more.
    """
    return local_ns + AHEAD_NS + round((local_ns - origin_ns) * skew_ppm * 1e-6)


def now_ns(origin_ns: int, skew_ppm: float) -> int:
    """What it shows now."""
    return scaled_ns(time.monotonic_ns(), origin_ns, skew_ppm)
