from collections import Counter
from pathlib import Path
from typing import Any

import pytest

from protocol.config.scene import validate
from protocol.errors import SceneError
from pulse_sensors.reading import Reading
from pulse_sensors.sensor import Sensor
from sensing_node.framer import Framer
from sensing_node.scene import SensingScene, build_source, describe_stream
from sensing_node.sources import PacedSource
from sensing_node.sources.live import LiveSource, feed_of
from tests.support.streams import MS, description, synthetic

SERIAL = {
    **{"kind": "serial", "port": "none", "framing": "text"},
    **{"rate": "1 kHz", "unit": "N"},
}


class Given(Sensor):
    """A sensor that gives readings it is told."""

    def __init__(self, *polls: list[Reading]) -> None:
        self.period_ns = MS
        self._polls = list(polls)

    def poll(self) -> list[Reading]:
        return self._polls.pop(0) if self._polls else []

    @property
    def rejected(self) -> Counter[str]:
        return Counter(crc=3)

    def faults(self) -> list[str]:
        return ["it hurts"]


def reading(first_ms: float, *force_n: float, missing: int = 0, period_ms: float = 1) -> Reading:
    end_ms = first_ms + len(force_n) * period_ms
    return Reading(round(first_ms * MS), round(end_ms * MS), force_n, missing)


def test_readings_that_follow_one_another_are_one_block() -> None:
    live = LiveSource(Given([reading(5, 0.1, 0.2), reading(7, 0.3, period_ms=1.3)]))
    block = live.read(0)
    assert block is not None
    assert (block.t_first_ns, block.period_ns, block.missing) == (5 * MS, round(3.3 / 3 * MS), 0)
    assert block.values.tolist() == [[0.1], [0.2], [0.3]]
    assert live.read(0) is None


def test_a_gap_ends_a_block_and_keeps_its_sequence_numbers() -> None:
    live = LiveSource(Given([reading(5, 0.1, 0.2), reading(17, 0.3, missing=10), reading(18, 0.4)]))
    framer = Framer(description(batch=5), 1)
    frames = []
    while (block := live.read(0)) is not None:
        frames += framer.frames(block)
    assert [(frame.first_sample, frame.t_first_ns, len(frame.values)) for frame in frames] == [
        (0, 5 * MS, 2),
        (12, 17 * MS, 2),
    ]
    assert framer.samples_sent == 14


def test_it_is_looked_at_once_a_batch() -> None:
    live = LiveSource(Given())
    assert live.due_ns(1) == MS
    live.read(50 * MS)
    assert live.due_ns(5) == 55 * MS
    assert not live.exhausted


def test_it_tells_what_its_sensor_tells() -> None:
    live = LiveSource(Given())
    assert (live.rejected, live.faults()) == ({"crc": 3}, ["it hurts"])


def test_a_feed_is_the_live_sensor_itself_or_paces_what_is_known() -> None:
    live = LiveSource(Given())
    assert feed_of(live, 7) is live
    assert isinstance(feed_of(synthetic(), 7), PacedSource)


def test_a_live_stream_is_described_by_its_nominal_rate() -> None:
    scene = validate({"source": SERIAL}, SensingScene, "scene")
    stream = describe_stream(scene, LiveSource(Given()))
    assert (stream.rate_hz, stream.batch, stream.group_delay_ns) == (1000, 5, 0)


def test_a_live_sensor_is_no_source_of_known_samples() -> None:
    scene = validate({"source": SERIAL}, SensingScene, "scene")
    with pytest.raises(SceneError, match='kind "serial" is a live sensor'):
        build_source(scene, Path())


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"source": SERIAL, "conditioning": {"mains": "50 Hz"}}, "has its own; leave it out"),
        ({"source": SERIAL | {"framing": "morse"}}, "'text' or 'binary'"),
        ({"source": SERIAL | {"framing": "binary", "column": 1}}, 'column is for framing "text"'),
        ({"source": SERIAL | {"device_time": "min"}}, "'us', 'ms' or 's'"),
        ({"source": SERIAL | {"prot": "x"}}, "unknown key; did you mean port?"),
    ],
)
def test_a_wrong_table_of_a_live_sensor_is_one_line(table: dict[str, Any], said: str) -> None:
    with pytest.raises(SceneError) as caught:
        validate(table, SensingScene, "x.toml: [sensing]")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
