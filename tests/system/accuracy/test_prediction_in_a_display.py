"""Predictors where they work: behind a display's buffer, when samples are late."""

import math
from dataclasses import replace

import pytest

from display_node.display import Display
from display_node.prediction import PredictorName
from protocol.wire.telemetry import TRACE_TICKS, TraceWriter, read_trace
from telepulse.scene import load_scene
from telepulse.simulation.link_model import parse_link
from telepulse.simulation.virtual_time import simulate
from tests.support.nodes import RADIAL
from tests.support.sender import Sender, display, run


def pulse_n(ms: int) -> float:
    return 0.3 + 0.05 * math.sin(2 * math.pi * 1.25e-3 * ms) + 0.03 * math.sin(5e-3 * math.pi * ms)


def play(under_test: Display, sender: Sender, from_ms: int, to_ms: int) -> None:
    for ms in range(from_ms, to_ms, 5):
        run(under_test, sender, ms, ms + 5, pulse_n(ms))


def in_phase_rmse_n(predictor: PredictorName) -> float:
    """Of the felt pulse against the present one, over a link that is 30 ms late."""
    scene = load_scene(RADIAL)
    changes = {"predictor": predictor, "compensation_ns": 0}
    late = replace(
        scene, display=scene.display.model_copy(update=changes), link=parse_link("delay=30ms")
    )
    rmse_n = simulate(late, 20, seed=1).force_rmse_n.in_phase
    assert rmse_n is not None
    return rmse_n


def test_the_stack_is_nearer_the_present_pulse_than_linear_over_a_late_link() -> None:
    assert in_phase_rmse_n("stack") < 0.65 * in_phase_rmse_n("linear")


@pytest.mark.parametrize("predictor", ["hold", "stack"])
def test_telemetry_has_the_error_that_the_predictor_expects(predictor: PredictorName) -> None:
    under_test, writer = display(predictor=predictor, compensation_ns=0), TraceWriter()
    play(under_test, Sender(), 0, 4_000)
    traces = [writer.add(under_test.tick_state) for _ in range(TRACE_TICKS)]
    expected_n = read_trace(traces[-1] or b"").predictor_error_n
    if predictor == "hold":
        assert all(map(math.isnan, expected_n))
    else:
        assert all(0 < each_n < 0.05 for each_n in expected_n)


def test_what_has_arrived_expects_no_error() -> None:
    under_test = display(predictor="stack", compensation_ns=40_000_000)
    play(under_test, Sender(), 0, 4_000)
    assert math.isnan(under_test.tick_state.predictor_error_n)


def test_another_session_is_learnt_anew() -> None:
    under_test = display(predictor="stack", compensation_ns=0)
    play(under_test, Sender(session=7), 0, 4_000)
    assert under_test.tick_state.predictor_error_n > 0
    play(under_test, Sender(session=8), 4_000, 6_000)
    assert under_test.receiver.sessions == 2
    assert math.isnan(under_test.tick_state.predictor_error_n)
