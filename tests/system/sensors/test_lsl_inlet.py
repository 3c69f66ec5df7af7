from contextlib import closing
from pathlib import Path

import pytest

from protocol.config.scene import validate
from protocol.errors import SourceError
from pulse_sensors import lsl_inlet
from pulse_sensors.lsl_inlet import LslScene
from pulse_sensors.sensor import open_sensor
from tests.support.lsl_loopback import lsl_on_loopback
from tests.support.sample_blocks import await_log, forces
from tests.support.waiting import until


def scene(**keys: object) -> LslScene:
    table = {"kind": "lsl", "stream": "telepulse test", "rate": "1 kHz", "unit": "mN"}
    return validate(table | keys, LslScene, "scene")


def test_a_stream_is_found_and_read_and_its_loss_is_logged(
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
    with closing(open_sensor(scene(channel=1), Path())) as sensor:
        until(outlets[0].have_consumers)
        force_n: list[float] = []

        def enough() -> bool:
            outlets[0].push_sample([0.0, 250.0])
            force_n.extend(forces(sensor.poll()))
            return len(force_n) >= 100

        until(enough)
        assert set(force_n) == {0.25}
        both = scene(channels=[1, 0], names=["cun", "announce"], announce_unit="uV")
        with closing(open_sensor(both, Path())) as several:
            rows: list[list[float]] = []

            def enough_rows() -> bool:
                outlets[0].push_sample([500.0, 250.0])
                rows.extend(row for block in several.poll() for row in block.values.tolist())
                return len(rows) >= 100

            until(enough_rows)
        assert rows[-1] == [0.25, 0.5]
        sensor.poll()
        outlets.clear()
        await_log(sensor, logged)
        assert logged == ["LSL stream telepulse test has gone: the stream has been lost."]
