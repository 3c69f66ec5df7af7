"""Prediction of the pulse where no sample has arrived yet.

To add a predictor, write an `Expert` in a module beside `fir.py`, add its name to `PredictorName`
and build it in `ensemble._experts`. A predictor that learns nothing is a `Predictor` itself, as in
`extrapolation.py`.
"""

from typing import Literal, Protocol

from display_node.prediction.extrapolation import Hold, Linear

PredictorName = Literal["hold", "linear", "fir", "analogue", "harmonic", "stack"]
UNLEARNT: tuple[PredictorName, ...] = ("hold", "linear")
"""Predictors that do not estimate their own error."""


class Predictor(Protocol):
    """Predicts one channel of one session; times are the sensing clock's. Pure and causal."""

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take a frame's samples, late or not; no sample comes twice."""

    def work(self) -> None:
        """Do what of the work a tick has room for; once a tick."""

    def predict(self, instant_ns: int) -> float:
        """Return the value at an instant after the newest sample; 0 before any."""

    def error_n(self, horizon_ns: int) -> float | None:
        """Present RMSE so far after the newest sample; None while nothing is known of it."""


def build_predictor(name: PredictorName, tick_ns: int) -> Predictor:
    """Build a predictor that has seen nothing; `work` will be called every `tick_ns`."""
    if name == "hold":
        return Hold()
    if name == "linear":
        return Linear()
    # The others bring linear algebra, whose import a display without them does not pay for.
    from display_node.prediction.ensemble import Ensemble

    return Ensemble(name, tick_ns)
