"""What a column is, and whether it has the shape of a pulse."""

import numpy as np
import pytest

from sensing_node.files.column_kind import find_pulse, named_kind

TIMES_S = np.arange(6000) / 100
PULSE = np.exp(-(((TIMES_S * 1.2 % 1 - 0.3) / 0.08) ** 2))
NOISE = np.random.default_rng(1).normal(size=len(PULSE))


def test_a_pulse_is_periodic_over_most_of_the_record_and_changes_within_a_beat() -> None:
    found = find_pulse(PULSE + 0.1 * NOISE, 100)
    assert found is not None
    assert found.per_min == pytest.approx(72, rel=0.01)
    most, third = np.where(TIMES_S < 45, PULSE, NOISE), np.where(TIMES_S < 20, PULSE, NOISE)
    held = np.repeat(PULSE[20::83], 83)[:6000]
    assert find_pulse(most, 100) is not None
    for no_pulse in (third, NOISE, np.cumsum(NOISE), np.round(PULSE), held, PULSE * np.nan):
        assert find_pulse(no_pulse, 100) is None
    # At a wrong unit of time, its rate is none of a pulse.
    assert find_pulse(PULSE, 100_000) is find_pulse(PULSE, 0.1) is None


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, "number") for name in ("ABP_SYS", "ABPMean", "PulseRate", "ART_MBP", "SpO2")),
        *((name, "status") for name in ("ppg_quality", "Status", "Artifact", "beat flag")),
        *((name, "time") for name in ("micros", "millis", "t [s]", "Zeit", "phoneTimestamp")),
        *((name, "counter") for name in ("COUNTER", "nSeq", "F/T Sequence")),
        *((name, None) for name in ("ABP", "art", "PPG100C", "force_N", "Fz", "SNUADC/ART", "IR")),
    ],
)
def test_a_name_states_what_a_column_is(name: str, kind: str | None) -> None:
    assert named_kind(name) == kind
