import re
from dataclasses import replace

import numpy as np
import pytest

from protocol.errors import BenchError
from telepulse.commissioning.sensor_check import SensorRecord, judge_sensor, reading_age_s

PERIOD_NS = 1_000_000
COUNT = 5_000


def samples(
    noise_n: float = 1e-3, hum_n: float = 0.0, zero_n: float = 0.0, batch: int = 8
) -> SensorRecord:
    """Samples every ms, read a batch at a time when the last of it was taken."""
    rng, t_s = np.random.default_rng(1), np.arange(COUNT) * 1e-3
    force_n = zero_n + noise_n * rng.standard_normal(COUNT)
    force_n += hum_n * np.sin(2 * np.pi * 50.1 * t_s)
    taken_ns = 10**12 + np.arange(COUNT) * PERIOD_NS
    return SensorRecord(
        taken_ns, force_n, taken_ns[batch - 1 :: batch], np.full(COUNT // batch, batch)
    )


def uneven(jitter_ns: int) -> SensorRecord:
    jitter = np.random.default_rng(2).normal(0, jitter_ns, COUNT).astype(np.int64)
    return replace(samples(), taken_ns=samples().taken_ns + jitter)


def verdicts(record: SensorRecord, nominal_hz: float = 1000.0) -> dict[str, str]:
    checks = judge_sensor(record, nominal_hz)
    assert all(check.reason for check in checks if check.verdict != "ok")
    return {check.name: check.verdict for check in checks if check.verdict != "ok"}


def numbers(record: SensorRecord, name: str) -> list[float]:
    """Return the numbers in the finding of a check."""
    (text,) = (check.text for check in judge_sensor(record, 1000.0) if check.name == name)
    return [float(number) for number in re.findall(r"\d+(?:\.\d+)?", text)]


def test_a_good_sensor_is_ok() -> None:
    assert numbers(samples(), "rate") == [1000.0]
    assert numbers(samples(), "jitter of sample times")[0] == 0
    noise_mn, mains_percent, _ = numbers(samples(), "noise")
    assert noise_mn == pytest.approx(1.0, rel=0.05)
    assert mains_percent < 5
    assert verdicts(samples()) == {}


def test_the_age_is_that_of_the_newest_sample_just_before_a_batch() -> None:
    assert reading_age_s(samples(batch=8)) == pytest.approx(8e-3)
    assert reading_age_s(samples(batch=1)) == pytest.approx(1e-3)


def test_mains_is_found_with_its_share() -> None:
    _, mains_percent, mains_hz = numbers(samples(noise_n=1e-3, hum_n=10e-3), "noise")
    assert mains_hz == 50
    assert mains_percent == pytest.approx(100 * 50 / 51, abs=2)
    assert verdicts(samples(hum_n=10e-3)) == {"noise": "warn", "mains": "warn"}


@pytest.mark.parametrize(
    ("record", "nominal_hz", "expected"),
    [
        (samples(), 992.0, {"rate": "warn"}),
        (samples(), 900.0, {"rate": "fail"}),
        (samples(noise_n=10e-3), 1000.0, {"noise": "warn"}),
        (samples(noise_n=50e-3), 1000.0, {"noise": "fail"}),
        (samples(zero_n=-0.1), 1000.0, {"zero": "warn"}),
        (replace(samples(), missing=1), 1000.0, {"missing samples": "warn"}),
        (replace(samples(), missing=500), 1000.0, {"missing samples": "fail"}),
        (uneven(400_000), 1000.0, {"jitter of sample times": "warn"}),
        (uneven(3_000_000), 1000.0, {"jitter of sample times": "fail"}),
    ],
)
def test_each_defect_is_named(
    record: SensorRecord, nominal_hz: float, expected: dict[str, str]
) -> None:
    assert verdicts(record, nominal_hz) == expected


def test_a_drift_is_no_noise() -> None:
    record = samples()
    drifting = replace(record, force_n=record.force_n + np.linspace(-0.02, 0.02, COUNT))
    assert numbers(drifting, "noise")[0] == pytest.approx(1.0, rel=0.05)


def test_a_live_reading_that_never_changes_is_not_ok() -> None:
    record = replace(samples(), force_n=np.zeros(COUNT))
    for live, verdict in ((True, "warn"), (False, "ok")):
        found = {check.name: check.verdict for check in judge_sensor(record, 1000.0, live)}
        assert found["noise"] == verdict


def test_a_record_that_is_too_short_or_stands_still_is_refused() -> None:
    record = samples()
    short = replace(record, taken_ns=record.taken_ns[:100], force_n=record.force_n[:100])
    with pytest.raises(BenchError, match="100 samples came from the sensor"):
        judge_sensor(short, 1000.0)
    with pytest.raises(BenchError, match="do not advance"):
        judge_sensor(replace(record, taken_ns=np.zeros_like(record.taken_ns)), 1000.0)
