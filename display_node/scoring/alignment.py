"""Alignment of the felt force with the pulse: the two instants with which it is compared. Pure."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Times = NDArray[np.int64]
# Largest gap of a pulse that is interpolated; within a larger one (a cut link) no error is known.
MAX_GAP_NS: Final = 60_000_000


def compared_forces_n(
    now_ns: NDArray[Any],
    instant_ns: NDArray[Any],
    film_age_ns: float,
    t_ns: NDArray[Any],
    target_n: Floats,
) -> tuple[Floats, Floats]:
    """Return the forces with which the felt force of ticks is compared: aligned, and in phase.

    The felt force F of a tick is the film's reading, which is older than the tick by A. With the
    target force f of the pulse at the finger and the playout delay E, the errors (eqs 23-25) are::

        aligned:  F − f(instant − A) = F − f(now − E − A)
        in phase: F − f(now − A)

    The aligned error is that of prediction and force loop; the one in phase has E in it as well.

    now_ns, instant_ns: time of each tick, and instant that it plays, in any shape. film_age_ns: A,
    0 where the film is modelled. t_ns, target_n: f in N at rising times. Forces are NaN where an
    instant is, outside of t_ns, and inside of gaps.
    """
    aligned_n, in_phase_n = interpolate(
        np.stack([instant_ns, now_ns]) - film_age_ns, t_ns, target_n
    )
    return aligned_n, in_phase_n


def rms(errors: Floats) -> float | None:
    """Return the root mean square of the errors that are known; None without any."""
    known = errors[~np.isnan(errors)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else None


def interpolate(at_ns: NDArray[Any], t_ns: NDArray[Any], values: Floats) -> Floats:
    """Interpolate linearly; NaN outside of t_ns and inside of gaps."""
    if not len(t_ns):
        return np.full(np.shape(at_ns), np.nan)
    found = np.searchsorted(t_ns, at_ns, side="right") - 1
    left = np.maximum(found, 0)
    left_ns, left_value = t_ns[left], values[left]
    # At its own time a value holds whatever follows: a gap, or an unknown value.
    right = np.minimum(left + (at_ns > left_ns), len(t_ns) - 1)
    gap_ns = t_ns[right] - left_ns
    share = (at_ns - left_ns) / np.maximum(gap_ns, 1)
    result: Floats = left_value + share * (values[right] - left_value)
    result[(found < 0) | (at_ns > t_ns[-1]) | (gap_ns > MAX_GAP_NS)] = np.nan
    return result
