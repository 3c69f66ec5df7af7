"""The kinds of predictors, each a name or a table in a scene."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BeforeValidator

from display_node.prediction import (
    WITHOUT_ERROR_ESTIMATE,
    Predictor,
    PredictorName,
    build_predictors,
    can_learn,
)
from protocol.config.kinds import KindGroup, KindTable, OfKind

if TYPE_CHECKING:
    from display_node.prediction.path_errors import ExpectedErrors
    from display_node.prediction.r_waves import RWaveTime
    from display_node.prediction.transit import TransitTime


class PredictorScene(KindTable):
    """Base of the `predictor` tables."""

    @property
    def estimates_error(self) -> bool:
        """True where the predictors estimate their own error, for `compensation = "auto"`."""
        return False

    @abstractmethod
    def build(self, tick_ns: int, count: int) -> Sequence[Predictor]:
        """Build the predictors of `count` channels of a stream, which have seen nothing.

        tick_ns: time between two ticks of the display. `work` of each is called in this order.
        """


class OwnPredictorScene(PredictorScene):
    """A predictor of telepulse; see `display_node/prediction/__init__.py`."""

    kind: PredictorName

    @property
    def estimates_error(self) -> bool:
        """See `PredictorScene.estimates_error`."""
        return self.kind not in WITHOUT_ERROR_ESTIMATE and can_learn()

    def build(self, tick_ns: int, count: int) -> list[Predictor]:
        """See `PredictorScene.build`."""
        return build_predictors(self.kind, count)


class BasePredictor:
    """Base of predictors without an estimate of their error, to be completed by two methods."""

    expected: "ExpectedErrors | None" = None
    transit: "TransitTime | None" = None

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        """Take a frame's samples, late or not; no sample comes twice."""
        raise NotImplementedError

    def predict(self, sampled_ns: int) -> float:
        """Return the value at a time after the newest sample; 0 before any."""
        raise NotImplementedError

    def work(self) -> None:
        """Do one tick's share of the work; it is called once a tick."""

    def error_n(self, horizon_ns: int) -> float | None:
        """Return None: the error is not estimated."""
        return None

    def announce(self, waves: "list[RWaveTime]") -> None:
        """Take R waves, and do not use them."""


PREDICTORS = KindGroup(
    "telepulse.predictors",
    "predictor",
    PredictorScene,
    dict.fromkeys(
        ("hold", "linear", "fir", "analogue", "stack"),
        "display_node.prediction.scene:OwnPredictorScene",
    ),
)


def _named(written: Any) -> Any:
    return {"kind": written} if isinstance(written, str) else written


PredictorTable = Annotated[PredictorScene, OfKind(PREDICTORS), BeforeValidator(_named)]


def own_predictor(name: PredictorName) -> OwnPredictorScene:
    """Return the table of one of telepulse's predictors."""
    return OwnPredictorScene(kind=name)


DEFAULT_PREDICTOR = own_predictor("stack")
