import numpy as np
import pytest

from display_node.prediction import PredictorName
from display_node.prediction.concealment import Concealment
from protocol.wire.messages import Frame

MS = 1_000_000


def concealment(predictor: PredictorName, auto: bool = True) -> Concealment:
    return Concealment(predictor, 0, MS, auto)


def frame(first: int, values: list[float]) -> Frame:
    """A sample a millisecond."""
    return Frame(1, first, first * MS, MS, np.array(values)[:, np.newaxis])


@pytest.mark.parametrize(
    ("predictor", "auto", "trusted"),
    [("linear", True, None), ("hold", True, None), ("stack", False, None), ("stack", True, False)],
)
def test_it_can_be_trusted_only_where_it_knows_its_error_and_has_a_say(
    predictor: PredictorName, auto: bool, trusted: bool | None
) -> None:
    stand_in = concealment(predictor, auto)
    stand_in.judge(5 * MS, 5 * MS)
    assert stand_in.trusted is trusted


def test_what_was_received_is_left_as_it_is() -> None:
    stand_in = concealment("linear")
    stand_in.observe(frame(0, [0.1, 0.2, 0.3]))
    path_n = [0.1, 0.2]
    assert stand_in.complete(path_n, 2, 0, 2 * MS) is path_n


def test_what_is_missing_is_predicted_and_comes_in_without_a_jump() -> None:
    stand_in = concealment("hold")
    stand_in.observe(frame(0, [0.3, 0.3]))
    assert stand_in.complete([0.3], 3, 1 * MS, 1 * MS) == pytest.approx([0.3] * 3)
    assert stand_in.complete([], 3, 5 * MS, 1 * MS) == pytest.approx([0.3] * 3)
    stand_in.observe(frame(2, [0.5] * 4))
    corrected = stand_in.complete([], 3, 6 * MS, 5 * MS)
    assert corrected[0] == pytest.approx(0.3)
    assert 0.3 < corrected[1] < corrected[2] < 0.5
