"""Predictors in a display whose samples are late."""

import math
from dataclasses import replace

import pytest

from display_node.display import Display
from display_node.prediction import PredictorName
from protocol.wire.telemetry import TRACE_TICKS, TraceWriter, read_trace
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import simulate
from tests.support.nodes import RADIAL, known
from tests.support.sender import Sender, display, run


def pulse_n(ms: int) -> float:
    return 0.3 + 0.05 * math.sin(2 * math.pi * 1.25e-3 * ms) + 0.03 * math.sin(5e-3 * math.pi * ms)


def play(under_test: Display, sender: Sender, from_ms: int, to_ms: int) -> None:
    for ms in range(from_ms, to_ms, 5):
        run(under_test, sender, ms, ms + 5, pulse_n(ms))


def test_the_stack_is_nearer_the_present_pulse_than_linear_over_a_late_link() -> None:
    scene, link, rmse_n = load_scene(RADIAL), parse_link("delay=30ms"), []
    for predictor in ("stack", "linear"):
        changes = {"predictor": predictor, "compensation_ns": 0}
        late = replace(scene, display=scene.display.model_copy(update=changes), link=link)
        rmse_n.append(known(simulate(late, 20, seed=1).force_rmse_n.in_phase))
    assert rmse_n[0] < 0.65 * rmse_n[1]


@pytest.mark.parametrize("predictor", ["hold", "stack"])
def test_telemetry_has_the_expected_error_of_the_predictor(predictor: PredictorName) -> None:
    under_test, writer = display(predictor=predictor, compensation_ns=0), TraceWriter()
    play(under_test, Sender(), 0, 4_000)
    traces = [writer.add(under_test.tick_state) for _ in range(TRACE_TICKS)]
    expected_n = read_trace(traces[-1] or b"").predictor_error_n
    if predictor == "hold":
        assert all(map(math.isnan, expected_n))
    else:
        assert all(0 < each_n < 0.05 for each_n in expected_n)


def test_received_samples_and_a_new_session_have_no_expected_error() -> None:
    buffered = display(predictor="stack", compensation_ns=40_000_000)
    play(buffered, Sender(), 0, 4_000)
    assert math.isnan(buffered.tick_state.predictor_error_n)
    under_test = display(predictor="stack", compensation_ns=0)
    play(under_test, Sender(session=7), 0, 4_000)
    assert under_test.tick_state.predictor_error_n > 0
    play(under_test, Sender(session=8), 4_000, 6_000)
    assert under_test.receiver.sessions == 2
    assert math.isnan(under_test.tick_state.predictor_error_n)
