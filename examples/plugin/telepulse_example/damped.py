"""A predictor: it continues the slope of the newest samples, which fades."""

import math
from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field

from protocol.config.quantities import Nanoseconds
from telepulse.plugins import BasePredictor, Predictor, PredictorScene

KEPT = 10


class DampedScene(PredictorScene):
    """The `predictor` table of kind "damped"; fades: time constant of the slope."""

    kind: Literal["damped"]
    fades_ns: Annotated[Nanoseconds, Field(ge=1_000_000, le=1_000_000_000)] = 20_000_000

    def build(self, tick_ns: int, count: int) -> Sequence[Predictor]:
        """See `PredictorScene.build`."""
        return [Damped(self.fades_ns) for _ in range(count)]


class Damped(BasePredictor):
    """Predictor of one channel."""

    def __init__(self, fades_ns: int) -> None:
        self._fades_ns = fades_ns
        self._samples: list[tuple[int, float]] = []

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Keep the newest samples, in order of time."""
        samples = [*self._samples, *zip(times_ns, values, strict=True)]
        self._samples = sorted(samples)[-KEPT:]

    def predict(self, sampled_ns: int) -> float:
        """Return the newest value, and what its slope adds until it has faded."""
        if len(self._samples) < 2:
            return self._samples[-1][1] if self._samples else 0.0
        (first_ns, first), (newest_ns, newest) = self._samples[0], self._samples[-1]
        slope = (newest - first) / (newest_ns - first_ns)
        passed = (sampled_ns - newest_ns) / self._fades_ns
        return newest - slope * self._fades_ns * math.expm1(-passed)
