"""Prediction: what the pulse is where no sample has arrived yet."""

from typing import Literal, Protocol

from display_node.prediction.extrapolation import Hold, Linear

PredictorName = Literal["hold", "linear", "fir", "analogue", "harmonic", "stack"]
UNLEARNT: tuple[PredictorName, ...] = ("hold", "linear")
"""Those that know nothing of their own error."""


class Predictor(Protocol):
    """Predicts one channel of one session; times are the sensing clock's. Pure and causal."""

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """A frame's samples have arrived, late or not; no sample comes twice."""

    def work(self) -> None:
        """Do what of the work a tick has room for; once a tick."""

    def predict(self, instant_ns: int) -> float:
        """The value at an instant after the newest sample; 0 before any."""

    def error_n(self, horizon_ns: int) -> float | None:
        """Present RMSE so far after the newest sample; None while nothing is known of it."""


def build_predictor(name: PredictorName, tick_ns: int) -> Predictor:
    """A predictor that has seen nothing; `work` will be called every `tick_ns`."""
    if name == "hold":
        return Hold()
    if name == "linear":
        return Linear()
    # The others bring linear algebra, whose import a display without them does not pay for.
    from display_node.prediction.ensemble import Ensemble

    return Ensemble(name, tick_ns)
