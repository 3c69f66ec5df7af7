import itertools
import math

import numpy as np
import pytest

from protocol.wire.description import Channel
from pulse_sensors.sample_plausibility import RateCheck, SampleCheck

MS = 1_000_000
PULSE = (Channel("pulse"),)


def test_implausible_live_samples_are_counted_and_reported_once(logged: list[str]) -> None:
    check = SampleCheck(MS, PULSE)
    check.add(np.full((5, 1), 0.3) + np.arange(5)[:, np.newaxis] * 1e-3)
    assert (check.faults(), logged) == ([], [])
    for number in range(600):
        check.add(np.array([[300.0 + number], [301.0], [math.nan], [0.3], [-0.2]]))
    assert logged == [
        "3 samples beyond 20 N, which no pulse reaches: check unit and scale in [sensing.source]",
        "399 samples (20 %) below 0 N, which no display can play: set a higher preload in"
        " [sensing.source], or check the sign",
    ]
    assert [fault.split(",")[0] for fault in check.faults()] == [
        "1800 samples beyond 20 N",
        "600 samples (20 %) below 0 N",
    ]


def test_a_constant_force_is_reported_once(logged: list[str]) -> None:
    check = SampleCheck(MS, PULSE)
    for force_n in itertools.chain([0.1, 0.2], itertools.repeat(0.3, 1600), [0.4]):
        check.add(np.full((5, 1), force_n))
    assert logged == ["the force did not change for 5.0 s: check the sensor"]
    assert check.faults() == ["the force did not change for 8.0 s: check the sensor"]


@pytest.mark.parametrize(
    ("sent_hz", "timeline_hz", "named_hz"),
    [
        ([800] * 3, 800, 800),
        # The timeline has not settled yet.
        ([1000] * 3, 900, None),
        ([800, 1000, 800], None, None),
        ([800] * 3 + [1000], None, None),
    ],
)
def test_a_rate_is_a_fault_where_timeline_and_count_are_wrong_for_two_seconds(
    sent_hz: list[int], timeline_hz: int | None, named_hz: int | None
) -> None:
    check, at_ns = RateCheck(1000), 0
    for hz in sent_hz:
        for _ in range(hz // 10):
            at_ns += 10 * 1_000_000_000 // hz
            check.add(10, at_ns, timeline_hz or hz)
    fault = check.fault("the board")
    named = f"the board sends {named_hz} Hz, the scene says 1000 Hz: check its rate"
    assert fault == (named if named_hz else None)


def test_each_channel_is_checked_by_itself_and_named(logged: list[str]) -> None:
    check = SampleCheck(MS, (Channel("cun"), Channel("guan"), Channel("announce", "mV")))
    for number in range(1200):
        moving = np.arange(5) * 1e-3 + number * 1e-6
        # An ECG may have any sign and size; the force of guan is stuck below 0 N.
        check.add(np.stack([moving + 0.3, np.full(5, -0.2), -300 - moving], axis=1))
    assert logged == [
        "guan: 2000 samples (100 %) below 0 N, which no display can play: set a higher preload in"
        " [sensing.source], or check the sign",
        "guan: the force did not change for 5.0 s: check the sensor",
    ]
    assert [fault.partition(":")[0] for fault in check.faults()] == ["guan", "guan"]
