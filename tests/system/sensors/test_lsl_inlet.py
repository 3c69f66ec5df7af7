import time
from contextlib import closing
from pathlib import Path

import pytest

from protocol.config.scene import validate
from protocol.errors import SourceError
from pulse_sensors import lsl_inlet
from pulse_sensors.lsl_inlet import Chunk, LslDecoder, LslScene
from pulse_sensors.reading import Packet
from pulse_sensors.scene import open_sensor
from tests.support.lsl_loopback import lsl_on_loopback
from tests.support.waiting import until

NAN = float("nan")


def scene(**keys: object) -> LslScene:
    table = {"kind": "lsl", "stream": "telepulse test", "rate": "1 kHz", "unit": "mN"}
    return validate(table | keys, LslScene, "scene")


def test_a_chunk_is_a_packet_with_the_time_of_its_last_sample() -> None:
    decoder = LslDecoder(1)
    first = Chunk([[9, 1], [9, 2]], [4.0, 4.001])
    second = Chunk([[9, 3]], [4.002])
    assert decoder.feed(first) == [Packet((1, 2), 4_001_000_000, anew=True)]
    assert decoder.feed(second) == [Packet((3,), 4_002_000_000)]
    decoder.reset()
    assert decoder.feed(second) == [Packet((3,), 4_002_000_000, anew=True)]


def test_what_is_no_number_is_counted_and_known_to_be_missing() -> None:
    decoder = LslDecoder(0)
    times_s = [1.0, 2.0, 3.0, 4.0, 5.0]
    packets = decoder.feed(Chunk([[1], [NAN], [NAN], [2], [NAN]], times_s))
    assert packets == [Packet((1,), 10**9, anew=True), Packet((2,), 4 * 10**9, missing=2)]
    assert decoder.feed(Chunk([[3]], [6.0])) == [Packet((3,), 6 * 10**9, missing=1)]
    assert decoder.rejected == {"not_finite": 3}


@pytest.mark.parametrize("time_s", [NAN, float("inf"), -1e300, 1e300])
def test_a_time_that_no_clock_has_is_counted(time_s: float) -> None:
    decoder = LslDecoder(0)
    assert decoder.feed(Chunk([[1]], [time_s])) == []
    assert decoder.rejected == {"not_finite": 1}


def test_a_stream_is_found_read_and_named_when_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, logged: list[str]
) -> None:
    pylsl = lsl_on_loopback(tmp_path, monkeypatch)
    monkeypatch.setattr(lsl_inlet, "RESOLVE_S", 10.0)
    info = pylsl.StreamInfo("telepulse test", "Force", 2, 1000, pylsl.cf_float32, "telepulse")
    outlets = [pylsl.StreamOutlet(info)]
    with pytest.raises(SourceError, match="no channel 2; it has 2"):
        open_sensor(scene(channel=2), Path())
    with pytest.raises(SourceError, match="its rate is 1000 Hz, the scene says 500"):
        open_sensor(scene(rate="500 Hz"), Path())
    force_n: list[float] = []
    with closing(open_sensor(scene(channel=1), Path())) as sensor:
        until(outlets[0].have_consumers)

        def enough() -> bool:
            outlets[0].push_sample([0.0, 250.0])
            force_n.extend(f for reading in sensor.poll() for f in reading.force_n)
            return len(force_n) >= 100

        until(enough)
        assert set(force_n) == {0.25}
        outlets.clear()

        def gone() -> bool:
            sensor.poll()
            time.sleep(0.01)
            return bool(logged)

        until(gone)
        assert logged == ["LSL stream telepulse test has gone: the stream has been lost."]
