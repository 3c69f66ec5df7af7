"""Predictors in a display whose samples are late."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

from display_node.prediction import PredictorName
from display_node.telemetry.alerts import alerts
from protocol.wire.telemetry import read_trace
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation
from tests.support.nodes import RADIAL, assert_accounted, known
from tests.support.sender import MS, Sender, display, run
from tests.support.tick_blocks import packed_trace


def test_samples_whose_instant_was_predicted_well_are_not_late_and_their_error_is_small() -> None:
    summary = Simulation(replace(load_scene(RADIAL), link=parse_link("delay=20ms")), 1).run(25)
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


def test_samples_of_a_stale_stream_are_late_however_far_prediction_was_trusted_before() -> None:
    cut = parse_link("delay=20ms,transport=tcp,cut.from=15s,cut.for=400ms")
    samples = Simulation(replace(load_scene(RADIAL), link=cut), 1).run(18).samples
    assert_accounted(asdict(samples))
    assert known(samples.predicted) > 5_000
    # The force fades once the newest sample is 60 ms older than usual.
    assert known(samples.late) > 400 - 60
    assert samples.lost == 0


@pytest.mark.parametrize("predictor", ["hold", "stack"])
def test_telemetry_has_the_expected_error_of_the_predictor(predictor: PredictorName) -> None:
    under_test, sender = display(predictor=predictor, compensation_ns=0), Sender()
    for ms in range(0, 4_000, 5):
        run(under_test, sender, ms, ms + 5, 0.3 + 0.05 * math.sin(2 * math.pi * 1.25e-3 * ms))
    (trace,) = read_trace(packed_trace(under_test.states[0]))
    (expected_n,) = trace.predictor_error_n
    assert math.isnan(expected_n) if predictor == "hold" else 0 < expected_n < 0.05
