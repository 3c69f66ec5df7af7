"""Prediction computes in the loop's own thread: a library's threads stall it on a busy host."""

import time

import pytest

from display_node.prediction import Predictor
from display_node.prediction.scene import own_predictor
from tests.support.streams import synthetic

MS = 1_000_000


@pytest.mark.parametrize("channels", [1, 3, 8])
def test_the_prediction_of_any_number_of_channels_uses_no_other_thread(channels: int) -> None:
    values = synthetic(rate="1 kHz", noise="0.5 mN").take(6_000)[:, 0].tolist()
    predictors: list[Predictor] = own_predictor("stack").build(MS, channels)
    process_s, thread_s = time.process_time(), time.thread_time()
    for first in range(0, len(values), 5):
        times_ns = list(range(first * MS, (first + 5) * MS, MS))
        for predictor in predictors:
            predictor.observe(times_ns, values[first : first + 5])
        for _ in times_ns:
            predictors[0].work()
    thread_s = time.thread_time() - thread_s
    others_s = time.process_time() - process_s - thread_s
    # Threads of LAPACK took as long as this one, each while the other waited for it. Shares of the
    # processor's time, which no other program and no speed of the processor changes.
    assert others_s < 0.3 * thread_s + 0.1
