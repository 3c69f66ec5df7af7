from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.config.scene import load_section, validate
from protocol.errors import SceneError, SourceError
from protocol.tactile import ElasticLayer
from protocol.wire.messages import MAX_FRAME_BYTES, Frame, encode_frame
from protocol.wire.stream import StreamDescription
from sensing_node.conditioning import Conditioned
from sensing_node.scene import SensingScene, build_source, describe_stream, open_source
from sensing_node.sources.recorded import RecordedSource
from sensing_node.sources.synthetic import SyntheticSource
from tests.support.nodes import ROOT
from tests.support.recording_files import csv_file

RECORDING = {"kind": "recording", "path": "pulse.csv", "rate": "100 Hz", "unit": "N"}
SERIAL = {"kind": "serial", "port": "none", "framing": "text", "rate": "1 kHz", "unit": "N"}


def scene(**keys: Any) -> SensingScene:
    return validate({"source": {"kind": "synthetic"}} | keys, SensingScene, "scene")


def source(**keys: Any) -> dict[str, Any]:
    return {"source": {"kind": "synthetic"} | keys}


# Scenes with a live sensor, which `build_source` refuses.
PROBE = {"kind": "tmcl", "port": "x"}
LIVE = ("tmcl_bench", "cia402_bench", "three_fingers_bench", "real_press")
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


def test_the_description_has_defaults() -> None:
    section = scene()
    stream = describe_stream(section, build_source(section, Path()))
    assert (stream.name, stream.batch, stream.bytes_per_sample) == ("pulse", 5, 4)
    assert (stream.group_delay_ns, stream.layer) == (0, ElasticLayer(0.05e9, 2e-3, 0.5, 1.0))


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
    ("rate", "batch", "samples"),
    [
        ("1 kHz", "100 us", 1), ("10 Hz", "5 ms", 1), ("1 kHz", "7.4 ms", 7),
        ("4096 Hz", "1 s", 4096), ("100 kHz", "5 ms", 500),
    ],
)  # fmt: skip
def test_a_batch_is_rounded_to_whole_samples(rate: str, batch: str, samples: int) -> None:
    section = scene(**source(rate=rate), batch=batch)
    assert describe_stream(section, build_source(section, Path())).batch == samples


def test_a_batch_of_too_many_samples_is_refused() -> None:
    section = scene(**source(rate="4097 Hz"), batch="1 s")
    with pytest.raises(SceneError, match=r"^\[sensing\] batch: 4097 samples a frame; at most 4096"):
        describe_stream(section, build_source(section, Path()))


@pytest.mark.parametrize(
    ("table", "key", "message"),
    [
        ({}, "source", "missing"), ({"source": {}}, "source", "kind"),
        ({"source": {"kind": "guitar"}}, "source", "recording"),
        (source(colour="red"), "source.colour", "unknown key"),
        (source() | {"bath": "5 ms"}, "bath", "unknown key"),
        (source() | {"batch_ns": 5}, "batch_ns", "unknown key"),
        (source(rate=1000), "source.rate", "1000 is no frequency"),
        (source(rate="1 ms"), "source.rate", "'1 ms' is no frequency"),
        (source(rate="5 Hz"), "source.rate", "greater than or equal to 10"),
        (source(heart_rate="75 bpm"), "source.heart_rate", "'75 bpm' is no frequency"),
        (source(peak_to_peak="30 g"), "source.peak_to_peak", "'30 g' is no force"),
        (source(peak_to_peak="0 N"), "source.peak_to_peak", "greater than 0"),
        (source(preset="square"), "source.preset", "'paper' or 'wide'"),
        (source(ectopic=0.6), "source.ectopic", "less than or equal to 0.5"),
        (source(respiration="much"), "source.respiration", "'much' is no ratio"),
        (source() | {"batch": "5 N"}, "batch", "'5 N' is no time"),
        (source() | {"batch": "0 ms"}, "batch", "greater than or equal to"),
        (source() | {"samples": "int16"}, "samples", "'float32' or 'float64'"),
        (source() | {"stream": ""}, "stream", "at least 1 character"),
        (source() | {"layer": {"thickness": "2 N"}}, "layer.thickness", "'2 N' is no length"),
        ({"source": RECORDING | {"unit": "V"}}, "source", 'unit "V" needs film_radius or sens'),
        ({"source": RECORDING | {"unit": "raw"}}, "source", 'unit "raw" needs peak_to_peak'),
        ({"source": RECORDING | {"unit": "kg"}}, "source.unit", "'mN'"),
        ({"source": RECORDING | {"repeat": "twice"}}, "source.repeat", "'loop' or 'once'"),
        ({"source": RECORDING | {"column": -1}}, "source.column", "-1"),
        ({"source": RECORDING | {"peak_to_peak": "0.3 N"}}, "source",
         'peak_to_peak is for unit raw, not "N"'),
        ({"source": RECORDING | {"film_radius": "9 mm"}}, "source",
         'film_radius is for unit V or mV, not "N"'),
        ({"source": RECORDING | {"unit": "V", "film_radius": "9 mm", "sensitivity": "1 V/N"}},
         "source", "give one of them"),
        ({"source": SERIAL | {"framing": "morse"}}, "source.framing", "'text' or 'binary'"),
        ({"source": SERIAL | {"device_time": "min"}}, "source.device_time", "'us', 'ms' or 's'"),
        ({"source": SERIAL | {"prot": "x"}}, "source.prot", "unknown key; did you mean port?"),
        ({"source": SERIAL | {"framing": "binary", "column": 1}}, "source",
         'column is for framing "text"'),
    ],
)  # fmt: skip
def test_a_wrong_scene_is_refused_in_one_line_with_the_key(
    table: dict[str, Any], key: str, message: str
) -> None:
    with pytest.raises(SceneError) as caught:
        validate(table, SensingScene, "x.toml: [sensing]")
    text = str(caught.value)
    assert text.startswith(f"x.toml: [sensing] {key}: ")
    assert message in text
    assert "\n" not in text


def test_the_conditioning_of_a_live_sensor_is_refused() -> None:
    with pytest.raises(SceneError, match="has its own; leave it out"):
        scene(source=SERIAL, conditioning={"mains": "50 Hz"})


def test_the_kind_decides_the_source(tmp_path: Path, logged: list[str]) -> None:
    # A pulse too small to feel is opened with a warning.
    path = csv_file(tmp_path, {"force": [1e-4, 2e-4]})
    recording = scene(source=RECORDING)
    with open_source(recording, tmp_path) as opened:
        assert isinstance(opened, RecordedSource)
    assert logged == [f"{path}: is 0.1 mN from peak to peak, too small to feel"]
    assert isinstance(build_source(scene(), tmp_path), SyntheticSource)
    chain = scene(conditioning={"mains": "50 Hz"})
    assert isinstance(build_source(chain, tmp_path), Conditioned)
    with pytest.raises(SourceError):
        build_source(recording, tmp_path / "elsewhere")
    with pytest.raises(SceneError, match='kind "serial" is a live sensor'):
        build_source(scene(source=SERIAL), tmp_path)


@pytest.mark.parametrize(
    ("press", "reason"),
    [
        ({}, r"press needs a source of kind .wrist., or a live sensor"),
        ({"resting": "0.9 N", "force_limit": "0.5 N"}, "resting must be at most force_limit"),
        ({"stale_after": "3 s"}, "stale_after must be at most leave_after"),
        ({"drive": PROBE, "max_speed": "0.15 m/s", "motor": {"max_speed": "0.1 m/s"}}, "max_speed"),
        ({"drive": PROBE, "motor": {"stroke": "20 mm"}}, "more than motor.stroke"),
        ({"drive": {**PROBE, "furthest": "1 mm"}}, "ends before the wrist"),
    ],
)
def test_a_real_probe_with_limits_that_do_not_fit_is_refused(
    press: dict[str, Any], reason: str
) -> None:
    board = {"kind": "serial", "port": "x", "framing": "binary", "rate": "1 kHz", "unit": "N"}
    with pytest.raises(ValueError, match=reason):
        SensingScene.model_validate({"source": board, "press": press})


def test_a_modelled_wrist_takes_no_real_drive() -> None:
    with pytest.raises(ValueError, match="models drive and load cell"):
        SensingScene.model_validate({"source": {"kind": "wrist"}, "press": {"drive": PROBE}})
