import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from display_node.prediction.scene import own_predictor
from protocol.config.scene import validate
from protocol.faults import Note, Part
from protocol.summary.fields import Limited
from protocol.wire.messages import Frame
from sensing_node.feeds import Framer, PacedFeed
from sensing_node.scene import SensingScene, build_source, describe_stream
from telepulse.scene import Scene, load_scene
from telepulse.simulation.true_errors import TrueForce
from telepulse.simulation.virtual_time import Simulation
from tests.support.nodes import RADIAL

RESTLESS = {"kind": "synthetic", "heart_rate_variability": "5 %", "noise": "1 mN"}
FILTERS = {"mains": "50 Hz", "anti_alias": "40 Hz", "adc_bits": 12}
CHARGE = {"charge_amplifier": "0.1 Hz", "hold_down": "0.2 N"}


def sensing(conditioning: dict[str, Any] | None = None, **source: object) -> SensingScene:
    table = {"source": RESTLESS | source}
    chain = {} if conditioning is None else {"conditioning": conditioning}
    return validate(table | chain, SensingScene, "scene")


def frames(scene: SensingScene) -> list[Frame]:
    """Return two seconds of the stream."""
    source = build_source(scene, Path())
    framer = Framer(describe_stream(scene, source), session=1)
    block = PacedFeed(source, 0).read(1_999_999_999)
    assert block is not None
    return framer.frames(block)


def truth(scene: SensingScene, of: list[Frame]) -> np.ndarray[Any, Any]:
    under_test = TrueForce(scene, Path())
    return np.concatenate([under_test.of(frame).values for frame in of])


def samples(scene: SensingScene) -> np.ndarray[Any, Any]:
    return build_source(scene, Path()).take(2000)


@pytest.mark.parametrize("conditioning", [None, {}, CHARGE])
def test_frames_of_an_ideal_chain_are_the_reference(conditioning: dict[str, Any] | None) -> None:
    scene = sensing(conditioning)
    under_test = TrueForce(scene, Path())
    assert all(under_test.of(frame) is frame for frame in frames(scene))


@pytest.mark.parametrize("conditioning", [FILTERS, {"adc_bits": 8}, {"anti_alias": "40 Hz"}, None])
def test_the_reference_is_the_pulse_before_chain_and_hum(
    conditioning: dict[str, Any] | None,
) -> None:
    scene = sensing(conditioning, hum="10 mN")
    sent = frames(scene)
    np.testing.assert_allclose(truth(scene, sent), samples(sensing()), rtol=1e-12)
    assert not np.allclose(np.concatenate([f.values for f in sent]), samples(sensing()), atol=1e-3)


def test_the_reference_loses_the_static_force_too() -> None:
    scene = sensing(CHARGE | FILTERS)
    np.testing.assert_array_equal(truth(scene, frames(scene)), samples(sensing(CHARGE)))


def test_missing_frames_do_not_shift_the_reference_which_differs_in_its_values_alone() -> None:
    scene = sensing(FILTERS)
    under_test, sent = TrueForce(scene, Path()), frames(scene)
    received = [*sent[30:50], *sent[51:]]
    reference = [under_test.of(frame) for frame in received]
    assert [frame[:4] for frame in reference] == [frame[:4] for frame in received]
    expected = np.delete(samples(sensing())[150:], slice(100, 105), axis=0)
    values = np.concatenate([frame.values for frame in reference])
    np.testing.assert_allclose(values, expected, rtol=1e-12)
    with pytest.raises(ValueError, match="sample 10 comes after 1999"):
        under_test.of(sent[2])


def conditioned(keys: dict[str, Any], **source: object) -> Scene:
    """Return the radial scene with a sensing chain."""
    scene = load_scene(RADIAL)
    changed = {"source": scene.sensing.source.model_copy(update=source)}
    chain = {"conditioning": sensing(keys).conditioning}
    return dataclasses.replace(
        scene,
        sensing=scene.sensing.model_copy(update=changed | chain),
        display=scene.display.model_copy(update={"predictor": own_predictor("linear")}),
    )


def rmse_mn(scene: Scene) -> float:
    """Return the aligned force RMSE of four simulated seconds."""
    aligned_n = Simulation(scene, 1).run(4).force_rmse_n.aligned
    assert aligned_n is not None
    return aligned_n * 1e3


def test_a_simulation_scores_what_the_adc_loses() -> None:
    step_mn = 20e3 / 2**14 / 0.044
    assert rmse_mn(conditioned({"adc_bits": 14})) == pytest.approx(step_mn / math.sqrt(12), rel=0.1)


def test_a_simulation_scores_hum_and_what_the_notch_leaves_of_it() -> None:
    hummed = rmse_mn(conditioned({}, hum_n=0.02))
    # The display goes from sample to sample, and the stepper follows 50 Hz.
    assert hummed == pytest.approx(20 / math.sqrt(2), rel=0.1)
    assert rmse_mn(conditioned({"mains": "50 Hz"}, hum_n=0.02)) < 2


def test_a_simulation_shifts_by_the_chains_delay() -> None:
    assert rmse_mn(conditioned({"anti_alias": "20 Hz"})) < 1.5


def test_a_simulation_reports_samples_beyond_the_adcs_range() -> None:
    summary = Simulation(conditioned({"adc_bits": 16, "adc_range": "5 mV"}), 1).run(2)
    assert summary.faults == []
    assert summary.notes == [Note(Part.SENSOR, "2000 samples beyond the ADC's range")]
    assert summary.limited.adc == Limited(1, 2.0, 1.0)
