from collections.abc import Iterator

import numpy as np
import pytest

from protocol.wire.description import Channel
from protocol.wire.messages import Frame, Welcome, encode_control, encode_frame
from protocol.wire.telemetry import CONTROL
from telepulse.recording.export_tables import RecordedBeats, rows
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import STATUS
from tests.support.drawn_beats import PERIOD_NS, Floats, analysed, draw, frames
from tests.support.streams import description
from tests.support.telemetry_publisher import WALL_NS, HandmadeTelemetry, clock_reply

# Sensing clock minus the display's, and time on the network.
AHEAD_NS, DELAY_NS = 5 * 10**12, 20_000_000


def recorded(forces_n: Floats) -> Iterator[Entry]:
    """Yield the entries of a stream of an ECG and two forces, shape (n, 3)."""
    telemetry = HandmadeTelemetry()
    channels = (Channel("ecg", "mV"), Channel("chi"), Channel("cun"))
    welcome = Welcome(1, 0, description(channels=channels))
    first_ns = frames(forces_n)[0][0] - AHEAD_NS
    for at_ns in range(first_ns - 50_000_000, first_ns, 10_000_000):
        reply = clock_reply(at_ns, AHEAD_NS, session=1)
        yield from telemetry.receive(
            (CONTROL, encode_control(welcome)), (CONTROL, reply), at_ns=at_ns
        )
    for number, (t_ns, values) in enumerate(frames(forces_n)):
        frame = Frame(1, number * len(values), t_ns, PERIOD_NS, values.astype("<f4"))
        at_ns = t_ns - AHEAD_NS + DELAY_NS
        # A copy over another path is no second frame.
        data = encode_frame(frame)
        yield from telemetry.receive((0, data), (1, data), at_ns=at_ns)
        if number == 40:
            names = [{"contactor": "cun", "channel": 2}, {"contactor": "chi", "channel": 1}]
            yield Entry(STATUS, 0, {"playing": names})


def test_each_contactor_has_the_beats_of_its_channel() -> None:
    pulse = draw().force_n[:12_000].astype("<f4").astype(float)
    later = 2 * np.roll(pulse, 7)
    beats = RecordedBeats()
    found_rows = [
        row
        for each in recorded(np.stack([pulse, pulse, later], 1))
        for beat in beats.take(each)
        for row in rows(beat)
    ]
    assert beats.units == ["mV", "N", "N"]
    for name, channel, force_n in (("cun", 2, later), ("chi", 1, pulse)):
        found, expected = [row for row in found_rows if row[0] == name], analysed(frames(force_n))
        assert len(expected) > 8
        for row, beat in zip(found, expected, strict=True):
            *head, foot_n, height_n, upstroke_ms, interval_ms, rate_per_min, quality, unix_ns = row
            times_ns = beat.onset_ns, beat.peak_ns, beat.notch_ns
            assert head == [name, channel, 1, *times_ns]
            assert (foot_n, height_n, quality) == (beat.foot_n, beat.height_n, beat.quality)
            assert upstroke_ms == pytest.approx((beat.peak_ns - beat.onset_ns) * 1e-6)
            assert rate_per_min == pytest.approx(60 / beat.interval_s)
            assert interval_ms == pytest.approx(beat.interval_s * 1e3)
            assert unix_ns == pytest.approx(beat.onset_ns - AHEAD_NS + WALL_NS, abs=1_000_000)
