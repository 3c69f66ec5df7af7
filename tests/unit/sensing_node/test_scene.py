from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.config.scene import load_section, validate
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer
from protocol.wire.description import StreamDescription
from protocol.wire.messages import MAX_FRAME_BYTES, Frame, encode_frame
from sensing_node.scene import SensingScene, build_source, describe_stream
from tests.support.nodes import ROOT
from tests.support.refusals import refusal_of

RECORDING = {"kind": "recording", "path": "pulse.csv", "rate": "100 Hz", "unit": "N"}
SERIAL = {"kind": "serial", "port": "none", "framing": "text", "rate": "1 kHz", "unit": "N"}


def scene(**keys: Any) -> SensingScene:
    return validate({"source": {"kind": "synthetic"}} | keys, SensingScene, "scene")


def source(**keys: Any) -> dict[str, Any]:
    return {"source": {"kind": "synthetic"} | keys}


# Scenes with a live sensor, which `build_source` refuses.
PROBE = {"kind": "tmcl", "port": "x"}
LIVE = (
    "tmcl_bench",
    "cia402_bench",
    "class_bench",
    "class_wrist",
    "three_fingers_bench",
    "real_press",
)
SENSED = [path for path in sorted((ROOT / "scenes").glob("*.toml")) if path.stem not in LIVE]


@pytest.mark.parametrize("path", SENSED, ids=lambda p: p.stem)
def test_every_shipped_scene_has_a_source(path: Path) -> None:
    section = load_section(path, "sensing", SensingScene)
    samples = build_source(section, path.parent)
    assert len(samples.take(10)) == 10
    assert describe_stream(section, samples).rate_hz == 1000


def test_the_scene_determines_the_description_of_the_stream() -> None:
    section = scene(
        **source(rate="500 Hz"),
        stream="left wrist",
        batch="10 ms",
        samples="float64",
        layer={"young_modulus": "2 MPa", "thickness": "3 mm", "poisson_ratio": 0.4},
    )
    stream = describe_stream(section, build_source(section, Path()))
    assert stream.name == "left wrist"
    assert stream.period_ns == 2_000_000
    assert stream.batch == 5
    assert stream.bytes_per_sample == 8
    assert [(channel.name, channel.unit) for channel in stream.channels] == [("pulse", "N")]
    assert stream.layer == ElasticLayer(2e6, 3e-3, 0.4, 1.0)


def test_the_largest_batch_of_several_channels_is_a_frame_and_one_sample_more_is_refused() -> None:
    def described(batch: str) -> StreamDescription:
        places = [{"name": str(number)} for number in range(8)]
        keys = source(rate="10 kHz", position=places) | {"batch": batch, "samples": "float64"}
        section = scene(**keys)
        return describe_stream(section, build_source(section, Path()))

    stream = described("102.3 ms")
    most = Frame(2**63 - 1, 2**53 - 1, 2**62 - 1, 10**10, np.zeros((stream.batch, 8)))
    assert stream.batch == 1023
    assert len(encode_frame(most)) <= MAX_FRAME_BYTES
    with pytest.raises(SceneError, match="1024 samples of 8 channels are more than a frame takes"):
        described("102.4 ms")


@pytest.mark.parametrize(
    ("table", "key", "message"),
    [
        ({}, "source", "missing"), ({"source": {}}, "source", "kind"),
        ({"source": {"kind": "guitar"}}, "source", "recording"),
        (source(rate="5 Hz"), "source.rate", "greater than or equal to 10"),
        ({"source": RECORDING | {"unit": "V"}}, "source", 'unit "V" needs film_radius or sens'),
        ({"source": RECORDING | {"unit": "raw"}}, "source", 'unit "raw" needs peak_to_peak'),
        ({"source": RECORDING | {"peak_to_peak": "0.3 N"}}, "source",
         'peak_to_peak is for unit raw, not "N"'),
        ({"source": RECORDING | {"film_radius": "9 mm"}}, "source",
         'film_radius is for unit V or mV, not "N"'),
        ({"source": RECORDING | {"unit": "V", "film_radius": "9 mm", "sensitivity": "1 V/N"}},
         "source", "give one of them"),
        ({"source": SERIAL | {"framing": "binary", "column": 1}}, "source",
         'column is for framing "text"'),
    ],
)  # fmt: skip
def test_a_wrong_scene_is_refused_in_one_line_with_the_key(
    table: dict[str, Any], key: str, message: str
) -> None:
    text = refusal_of(SceneError, validate, table, SensingScene, "x.toml: [sensing]")
    assert text.startswith(f"x.toml: [sensing] {key}: ")
    assert message in text


BOARD = SERIAL | {"framing": "binary"}
WRIST = {"kind": "wrist"}


@pytest.mark.parametrize(
    ("source", "press", "reason"),
    [
        (BOARD, {}, r"press needs a source of kind .wrist., or a live sensor"),
        ({"kind": "synthetic"}, {}, "press needs a source of kind .wrist."),
        (
            BOARD,
            {"resting": "0.9 N", "force_limit": "0.5 N"},
            "resting must be at most force_limit",
        ),
        (BOARD, {"stale_after": "3 s"}, "stale_after must be at most leave_after"),
        (
            BOARD,
            {"drive": PROBE, "max_speed": "0.15 m/s", "motor": {"max_speed": "0.1 m/s"}},
            "max_speed",
        ),
        (BOARD, {"drive": PROBE, "motor": {"stroke": "20 mm"}}, "more than motor.stroke"),
        (BOARD, {"drive": {**PROBE, "furthest": "1 mm"}}, "ends before the wrist"),
        (WRIST, {"drive": PROBE}, "models drive and load cell"),
    ],
)
def test_a_press_that_does_not_fit_its_source_or_limits_is_refused(
    source: dict[str, Any], press: dict[str, Any], reason: str
) -> None:
    with pytest.raises(SceneError, match=reason):
        scene(source=source, press=press)


def test_a_wrist_needs_a_press_and_no_conditioning_nor_does_a_live_sensor() -> None:
    for more, reason in (
        ({"source": WRIST}, r"pressed by a probe: add \[sensing.press\]"),
        ({"source": WRIST, "press": {}, "conditioning": {"mains": "50 Hz"}}, "leave it out for a"),
        ({"source": SERIAL, "conditioning": {"mains": "50 Hz"}}, "has its own; leave it out"),
    ):
        with pytest.raises(SceneError, match=reason):
            scene(**more)
