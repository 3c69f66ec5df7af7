import numpy as np
import pytest

from display_node.scoring.alignment import MAX_GAP_NS, compared_forces_n, interpolate

MS = 1_000_000
# A pulse that rises by 1 N/s, on a clock far from 0.
T_NS = 10**18 + np.arange(1000, dtype=np.int64) * MS
RAMP_N = np.arange(1000) * 1e-3


@pytest.mark.parametrize("kind", [np.asarray, int], ids=["array", "number"])
def test_a_films_reading_is_compared_with_its_own_time_and_the_instant_played_then(
    kind: type,
) -> None:
    now_ns, delay_ns, film_age_ns = kind(T_NS[500]), 40 * MS, 3 * MS
    aligned_n, in_phase_n = compared_forces_n(now_ns, now_ns - delay_ns, film_age_ns, T_NS, RAMP_N)
    assert (float(aligned_n), float(in_phase_n)) == pytest.approx((0.457, 0.497))


def test_at_its_own_time_each_sample_has_its_value_also_before_a_gap_and_at_the_end() -> None:
    t_ns = T_NS + (np.arange(1000) > 500) * MAX_GAP_NS
    unknown_n = np.where(np.arange(1000) == 700, np.nan, RAMP_N)
    np.testing.assert_array_equal(interpolate(t_ns, t_ns, unknown_n), unknown_n)


def test_outside_of_the_pulse_and_inside_of_a_gap_nothing_is_known() -> None:
    t_ns = T_NS + (np.arange(1000) > 500) * MAX_GAP_NS
    at_ns = [t_ns[0] - 1, t_ns[500] + 1, t_ns[501] - 1, t_ns[-1] + 1]
    assert np.isnan(interpolate(np.array(at_ns), t_ns, RAMP_N)).all()
    assert np.isnan(interpolate(T_NS, T_NS[:0], RAMP_N[:0])).all()
    assert np.isnan(compared_forces_n(np.array([np.nan]), T_NS[:1], 0, T_NS, RAMP_N)[1]).all()
