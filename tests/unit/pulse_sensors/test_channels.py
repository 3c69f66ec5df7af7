"""Sensors with several values in a sample: lines, frames, CAN messages and LSL chunks."""

import struct
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from protocol.config.scene import validate
from protocol.errors import SceneError
from protocol.wire.description import Channel
from pulse_sensors.binary_frames import MAX_SAMPLES, FrameDecoder, FrameEncoder, SampleFormat
from pulse_sensors.can_bus import CanDecoder
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.lsl_inlet import Chunk, LslDecoder, LslScene
from pulse_sensors.samples import Timestamper, decoded_block
from pulse_sensors.serial_port import SerialScene
from pulse_sensors.text_lines import TextDecoder
from tests.support.can_messages import can_scene, write_database
from tests.support.sample_blocks import Decoded, plain

MS = 1_000_000
TEXT = {"kind": "serial", "port": "none", "framing": "text", "rate": "1 kHz", "unit": "N"}
BINARY = TEXT | {"framing": "binary"}
LSL = {"kind": "lsl", "stream": "wrist", "rate": "1 kHz", "unit": "N"}
NAMES = {"names": ["cun", "guan", "announce"]}
CHANNELS = (Channel("cun"), Channel("guan"), Channel("announce", "mV"))


def serial(**keys: Any) -> SerialScene:
    return validate(TEXT | keys, SerialScene, "scene")


@pytest.mark.parametrize("timed", [False, True])
def test_several_values_of_a_line_are_one_sample(timed: bool) -> None:
    decoder = TextDecoder(MS, (2, 0), "us" if timed else None)
    lines = b"".join(
        (b"%d," % (i * 1000) if timed else b"") + b"cun:%d guan:7 chi:%d\r\n" % (i, -i)
        for i in range(5)
    )
    (block,) = decoder.feed(b"\n" + lines)
    assert block.values.tolist() == [[-i, i] for i in range(5)]
    # A line without one of the values is lost as a whole.
    assert decoder.feed(b"5000,1 2\n" if timed else b"1 2\n") == []
    assert decoder.rejected == {"not_a_number": 1}


@pytest.mark.parametrize("sample_format", ["int16", "int32", "float32"])
@pytest.mark.parametrize("channels", [1, 2, 3, 15])
def test_frames_hold_whole_samples_of_all_channels(
    sample_format: SampleFormat, channels: int
) -> None:
    encoder, decoder = FrameEncoder(sample_format, channels), FrameDecoder(MS, channels)
    values = np.arange(2 * MAX_SAMPLES * channels).reshape(-1, channels)
    data = b"\0" + encoder.frame(values[:MAX_SAMPLES].tolist(), MAX_SAMPLES * 1000)
    data += encoder.frame(values[MAX_SAMPLES:].tolist(), 2 * MAX_SAMPLES * 1000)
    blocks = [block for at in range(0, len(data), 7) for block in decoder.feed(data[at : at + 7])]
    assert [block.missing for block in blocks] == [0, 0]
    np.testing.assert_array_equal(np.concatenate([b.values for b in blocks]), values)
    assert not decoder.rejected


def test_a_frame_with_another_number_of_channels_is_rejected_and_lost_samples_are_counted() -> None:
    decoder, encoder = FrameDecoder(MS, 3), FrameEncoder("int16", 3)
    decoder.feed(b"\0" + encoder.frame([[1, 2, 3]] * 4, 4_000))
    assert decoder.feed(FrameEncoder("int16", 2).frame([[1, 2]] * 6, 5_000)) == []
    assert decoder.rejected == {"format": 1}
    encoder.frame([[4, 5, 6]] * 4, 8_000)
    (block,) = decoder.feed(encoder.frame([[7, 8, 9]] * 4, 12_000))
    assert (block.missing, block.values.tolist()) == (4, [[7, 8, 9]] * 4)


def test_signals_of_one_message_are_one_sample(tmp_path: Path) -> None:
    write_database(tmp_path)
    scene = can_scene(signals=["Single", "Tick"])
    decoder = CanDecoder(scene, tmp_path)
    assert [channel.name for channel in scene.wire_channels] == ["Single", "Tick"]
    data = struct.pack("<ff", 0.25, -0.5)
    received = can.Message(1.0, arbitration_id=295, is_extended_id=False, data=data)
    (block,) = decoder.feed(received)
    assert block.values.tolist() == [[0.25, -0.5]]
    bad = can.Message(1.0, arbitration_id=295, is_extended_id=False, data=b"\0\0\xc0\x7f" * 2)
    assert decoder.feed(bad) == []
    assert sum(decoder.rejected.values()) == 1


def test_channels_of_an_lsl_stream_are_one_sample() -> None:
    scene = validate(LSL | {"channels": [2, 0]}, LslScene, "scene")
    assert [channel.name for channel in scene.wire_channels] == ["channel 2", "channel 0"]
    decoder = LslDecoder(scene.numbers)
    (block,) = decoder.feed(Chunk([[1, 9, 3], [4, 9, 6]], [4.0, 4.001]))
    assert block.values.tolist() == [[3, 1], [6, 4]]
    assert decoder.feed(Chunk([[1, 9, float("nan")]], [4.002])) == []
    assert decoder.rejected == {"not_finite": 1}


@pytest.mark.parametrize(
    ("unit", "factor"), [({}, 1.0), ({"announce_unit": "uV"}, 1e-3), ({"announce_unit": "V"}, 1e3)]
)
def test_forces_are_scaled_and_an_ecg_has_a_unit_of_its_own(
    unit: dict[str, str], factor: float
) -> None:
    scale = {"unit": "counts", "newtons_per_count": 1e-4, "zero": 100, "preload": "0.5 N"}
    scene = validate(BINARY | NAMES | scale | unit, SerialScene, "scene")
    assert scene.wire_channels == CHANNELS
    block = Timestamper(scene).timestamp(decoded_block([[1100, 2100, 300]]), 10**15)
    assert block is not None
    np.testing.assert_allclose(block.values, [[0.6, 0.7, 300 * factor]])


@pytest.mark.parametrize(
    ("table", "schema", "message"),
    [
        (TEXT | {"columns": [0, 1], "names": ["cun"]}, SerialScene,
         "names gives 1 name, and a sample has 2 values"),
        (TEXT | {"column": 1, "names": ["cun", "chi"]}, SerialScene,
         "names gives 2 names, and a sample has 1 value"),
        (TEXT | {"column": 1, "columns": [1, 2]}, SerialScene, "give one of the two keys"),
        (BINARY | {"columns": [1, 2]}, SerialScene, 'columns is for framing "text"'),
        (TEXT | {"names": ["cun", "cun"]}, SerialScene, "two channels have the name 'cun'"),
        (TEXT | {"names": ["announce"]}, SerialScene, "a pulse needs a channel of force"),
        (TEXT | {"announce_unit": "V"}, SerialScene, 'announce_unit is for a channel named'),
        (LSL | {"channel": 1, "channels": [1, 2]}, LslScene, "give one of the two keys"),
    ],
)  # fmt: skip
def test_keys_of_channels_that_contradict_are_refused(
    table: dict[str, Any], schema: type[SensorTable], message: str
) -> None:
    with pytest.raises(SceneError, match=message) as refused:
        validate(table, schema, "[sensing] source")
    assert "\n" not in str(refused.value)


NAN = float("nan")


def test_a_chunk_is_a_block_with_the_time_of_its_last_sample() -> None:
    decoder = LslDecoder((1,))
    first, second = Chunk([[9, 1], [9, 2]], [4.0, 4.001]), Chunk([[9, 3]], [4.002])
    assert plain(decoder.feed(first)) == [Decoded((1, 2), 4_001_000_000, restarted=True)]
    assert plain(decoder.feed(second)) == [Decoded((3,), 4_002_000_000)]
    decoder.reset()
    assert plain(decoder.feed(second)) == [Decoded((3,), 4_002_000_000, restarted=True)]


def test_samples_that_are_no_numbers_count_as_missing() -> None:
    decoder = LslDecoder((0,))
    blocks = decoder.feed(Chunk([[1], [NAN], [NAN], [2], [NAN]], [1.0, 2.0, 3.0, 4.0, 5.0]))
    blocks += decoder.feed(Chunk([[3]], [6.0]))
    assert plain(blocks) == [
        Decoded((1,), 10**9, restarted=True),
        Decoded((2,), 4 * 10**9, missing=2),
        Decoded((3,), 6 * 10**9, missing=1),
    ]
    assert decoder.rejected == {"not_finite": 3}


@pytest.mark.parametrize("time_s", [NAN, float("inf"), -1e300, 1e300])
def test_a_sample_with_an_impossible_time_is_rejected(time_s: float) -> None:
    decoder = LslDecoder((0,))
    assert decoder.feed(Chunk([[1]], [time_s])) == []
    assert decoder.rejected == {"not_finite": 1}
