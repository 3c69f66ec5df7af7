"""Predictors in a display whose samples are late."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from display_node.display import Display
from display_node.prediction import PredictorName
from display_node.telemetry.alerts import alerts
from protocol.wire.telemetry import TRACE_TICKS, TraceWriter, read_trace
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import summarise
from tests.support.nodes import RADIAL, assert_accounted, known
from tests.support.sender import MS, Sender, display, run


def pulse_n(ms: int) -> float:
    return 0.3 + 0.05 * math.sin(2 * math.pi * 1.25e-3 * ms) + 0.03 * math.sin(5e-3 * math.pi * ms)


def play(under_test: Display, sender: Sender, from_ms: int, to_ms: int) -> None:
    for ms in range(from_ms, to_ms, 5):
        run(under_test, sender, ms, ms + 5, pulse_n(ms))


def test_samples_whose_instant_was_predicted_well_are_not_late_and_their_error_is_small() -> None:
    summary = summarise(replace(load_scene(RADIAL), link=parse_link("delay=20ms")), 25, seed=1)
    samples, used = summary.samples, summary.compensation
    assert_accounted(asdict(samples))
    assert known(samples.predicted) > 10_000
    assert (samples.late, samples.lost) == (0, 0)
    assert known(used.predicted) > 0.3
    assert 5 < known(used.horizon_ms) < 25
    # A tenth of what a finger notices.
    assert known(used.error_share) < 0.01
    assert known(used.error_n) == pytest.approx(known(used.error_share) * 0.31, rel=0.15)
    assert (used.corrections, used.alarm) == (0, False)
    assert alerts("playing", summary.to_dict()) == []


def test_a_bad_prediction_is_late_samples_felt_corrections_and_an_alert() -> None:
    under_test, sender = display(predictor="hold", compensation_ns=0), Sender()
    for ms in range(10_000):
        while under_test.work():
            pass
        under_test.tick(ms * MS)
        sender.serve(under_test, ms * MS)
        if ms % 5 == 0:
            # Up or down by 0.1 N every 250 ms, which the display receives 40 ms later.
            force_n = 0.3 + 0.1 * ((np.arange(ms - 44, ms - 39) // 250) % 2)
            under_test.on_frame(sender.frame_of((ms - 40) * MS, force_n.tolist()), ms * MS)
    summary = under_test.summary()
    samples, used = summary.samples, summary.compensation
    assert_accounted(asdict(samples))
    assert samples.predicted == 0
    assert known(samples.late) > 9_000
    # One for each step that arrives from 2 s on, when the height is known.
    assert used.corrections == 4 * 8
    assert used.corrections_per_min == pytest.approx(60 * 32 / 9.75, rel=0.01)
    # Each step is felt 43 ms late, and the blend takes 20 ms to come within 10 %.
    assert used.noticed_5s == pytest.approx(63 / 250, abs=0.01)
    (alert,) = alerts("playing", summary.to_dict())
    assert alert.name == "prediction"


@pytest.mark.parametrize("predictor", ["hold", "stack"])
def test_telemetry_has_the_expected_error_of_the_predictor(predictor: PredictorName) -> None:
    under_test, writer = display(predictor=predictor, compensation_ns=0), TraceWriter()
    play(under_test, Sender(), 0, 4_000)
    for _ in range(TRACE_TICKS):
        writer.add(under_test.states[0])
    (trace,) = read_trace(writer.rest() or b"")
    expected_n = trace.predictor_error_n
    if predictor == "hold":
        assert all(map(math.isnan, expected_n))
    else:
        assert all(0 < each_n < 0.05 for each_n in expected_n)


def test_received_samples_and_a_new_session_have_no_expected_error() -> None:
    buffered = display(predictor="stack", compensation_ns=40_000_000)
    play(buffered, Sender(), 0, 4_000)
    assert math.isnan(buffered.states[0].predictor_error_n)
    under_test = display(predictor="stack", compensation_ns=0)
    play(under_test, Sender(session=7), 0, 4_000)
    assert under_test.states[0].predictor_error_n > 0
    play(under_test, Sender(session=8), 4_000, 6_000)
    assert under_test.receiver.sessions == 2
    assert math.isnan(under_test.states[0].predictor_error_n)


def test_samples_of_a_stale_stream_are_late_however_far_prediction_was_trusted_before() -> None:
    cut = parse_link("delay=20ms,transport=tcp,cut.from=15s,cut.for=400ms")
    samples = summarise(replace(load_scene(RADIAL), link=cut), 18, seed=1).samples
    assert_accounted(asdict(samples))
    assert known(samples.predicted) > 5_000
    # The force fades once the newest sample is 60 ms older than usual.
    assert known(samples.late) > 400 - 60
    assert samples.lost == 0
