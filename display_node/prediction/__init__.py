"""Prediction of the pulse where no sample has arrived yet.

To add a predictor that learns:

1. Write an `Expert` (`expert.py`), as `fir.py` is one.
2. Build it in `ensemble.Ensemble`.
3. Add its name to `PredictorName`, here.

A predictor that learns nothing is a `Predictor`, like `Linear`; build it in `build_predictors`.

A predictor of another distribution is a kind of `PREDICTORS` (`scene.py`, `docs/howto/plugins.md`).
"""

import logging
from bisect import bisect_left
from functools import cache
from typing import TYPE_CHECKING, Literal, Protocol

if TYPE_CHECKING:
    from display_node.prediction.path_errors import ExpectedErrors
    from display_node.prediction.r_waves import RWaveTime
    from display_node.prediction.transit import TransitTime

logger = logging.getLogger(__name__)

PredictorName = Literal["hold", "linear", "fir", "analogue", "stack"]
WITHOUT_ERROR_ESTIMATE: tuple[PredictorName, ...] = ("hold", "linear")
"""Predictors that do not estimate their own error."""
# Time over which a slope is measured, and for which it is continued; samples kept for it.
WINDOW_NS, REACH_NS = 10_000_000, 20_000_000
KEEP = 32
# Time constant with which a correction is blended in, as a share of the horizon of the old
# prediction: corrections of a longer prediction are larger, and may take longer.
DECAY_OVER_HORIZON = 0.2


class Predictor(Protocol):
    """Predictor of one channel of one session; times are on the sensing clock. Pure and causal."""

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take a frame's samples, late or not; no sample comes twice."""

    def work(self) -> bool:
        """Do one piece of the waiting work; return whether there was any.

        A display calls it at least once a tick, after the tick's command, and repeats it until
        nothing waits or the next tick is near. A piece takes less than a quarter of a tick.
        """
        return False

    def predict(self, sampled_ns: int) -> float:
        """Return the value at a time after the newest sample; 0 before any."""

    def error_n(self, horizon_ns: int) -> float | None:
        """Return the expected RMSE `horizon_ns` after the newest sample; None if unknown."""
        return None

    def announce(self, waves: "list[RWaveTime]") -> None:
        """Take R waves of the heart whose pulse is predicted, which announce its beats."""
        return

    @property
    def transit(self) -> "TransitTime | None":
        """Transit time from R waves to the pulse; None without R waves or where none are used."""
        return None

    @property
    def expected(self) -> "ExpectedErrors | None":
        """Errors to expect of the prediction; None without an estimate, or before there is one."""
        return None


class Linear(Predictor):
    """Predictor that continues the newest value linearly for `reach_ns`, then holds it."""

    def __init__(self, reach_ns: int) -> None:
        self._reach_ns = reach_ns
        self._samples: list[tuple[int, float]] = []

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Keep the newest samples in time order; none may come between those of a call."""
        samples, place = self._samples, len(self._samples)
        if place and times_ns[0] < samples[-1][0]:
            place = bisect_left(samples, (times_ns[0],))
        samples[place:place] = zip(times_ns, values, strict=True)
        del samples[:-KEEP]

    def predict(self, sampled_ns: int) -> float:
        """Return the newest value, continued with the slope of the last 10 ms."""
        if not self._samples:
            return 0.0
        newest_ns, newest = self._samples[-1]
        for t_ns, value in reversed(self._samples):
            if newest_ns - t_ns > WINDOW_NS:
                break
            first_ns, first = t_ns, value
        if newest_ns == first_ns:
            return newest
        slope = (newest - first) / (newest_ns - first_ns)
        return newest + slope * min(sampled_ns - newest_ns, self._reach_ns)


@cache
def can_learn() -> bool:
    """Return whether predictors that learn can be built here; warn once if they cannot.

    Their kernels are compiled by numba, which new versions of Python have to wait for.
    """
    try:
        import numba  # noqa: F401
    except (ImportError, OSError) as error:  # The latter where its library does not fit.
        logger.warning(
            f'the predictor "linear" plays in place of one that learns: numba cannot be loaded'
            f" ({error}); use a version of Python for which `pip install numba` finds a wheel"
        )
        return False
    return True


def build_predictors(name: PredictorName, count: int = 1) -> list[Predictor]:
    """Build the predictors of `count` channels of a stream, which have seen nothing."""
    if name in WITHOUT_ERROR_ESTIMATE or not can_learn():
        return [Linear(0 if name == "hold" else REACH_NS) for _ in range(count)]
    # Imported here, so that a display without these predictors does not load numba.
    from display_node.prediction.ensemble import Ensemble

    ensemble = Ensemble(name, count)
    return [ensemble, *ensemble.others]
