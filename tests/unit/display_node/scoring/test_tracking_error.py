import math
import tracemalloc
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.scoring.tracking_error import (
    MAX_GAP_NS,
    TrackingError,
    compared_forces_n,
    interpolate,
)
from display_node.scoring.waiting_ticks import BLOCK
from protocol.summary.phrases import windows_text
from protocol.tactile import ElasticLayer
from tests.support.sender import Sender, display, run

MS = 1_000_000
T0_NS = 1_700_000_000_000_000_000
TICK_NS = MS
DELAY_NS = 43 * MS
STRAIN_PER_NEWTON = ElasticLayer().strain_per_newton
Times = NDArray[np.int64]
Forces = NDArray[np.float64]
# A pulse that rises by 1 N/s, on a clock far from 0.
T_NS = 10**18 + np.arange(1000, dtype=np.int64) * MS
RAMP_N = np.arange(1000) * 1e-3


def pulse_n(t_ns: Times) -> Forces:
    """Return a sine of 0.3 N from peak to peak at 75 /min."""
    return 0.3 + 0.15 * np.sin(2 * math.pi * 1.25 * (t_ns - T0_NS) * 1e-9)


def sample_times_ns(duration_s: float) -> Times:
    return T0_NS + np.arange(round(duration_s * 1000), dtype=np.int64) * MS


def tick_times_ns(from_s: float, to_s: float) -> Times:
    """Return times of ticks, which fall between the samples."""
    first, last = round(from_s * 1000), round(to_s * 1000)
    return T0_NS + np.arange(first, last, dtype=np.int64) * TICK_NS + 370_000


def frames(t_ns: Times, size: int = 5) -> list[Times]:
    return np.split(t_ns, range(size, len(t_ns), size))


def add_reference(error: TrackingError, pieces: Iterable[Times]) -> None:
    for t_ns in pieces:
        error.add_pulse(t_ns.tolist(), pulse_n(t_ns).tolist())


def add_output(
    error: TrackingError, ticks_ns: Times, forces_n: Forces, delay_ns: int = DELAY_NS
) -> None:
    for first in range(0, len(ticks_ns), BLOCK):
        now_ns = ticks_ns[first : first + BLOCK]
        error.add_output(now_ns, now_ns, now_ns - delay_ns, forces_n[first : first + BLOCK])


def scored(
    ticks_ns: Times,
    felt_n: Forces,
    reference: Sequence[Times] | None = None,
    delay_ns: int = DELAY_NS,
) -> TrackingError:
    """Score a felt force by a reference of 6 s, or by the given pieces of one."""
    error = TrackingError(STRAIN_PER_NEWTON)
    add_reference(error, frames(sample_times_ns(6.0)) if reference is None else reference)
    add_output(error, ticks_ns, felt_n, delay_ns)
    error.finish()
    return error


def rms(values: Forces) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("kind", [np.asarray, int], ids=["array", "number"])
def test_a_films_reading_is_compared_with_its_own_time_and_the_instant_played_then(
    kind: type,
) -> None:
    now_ns, delay_ns, film_age_ns = kind(T_NS[500]), 40 * MS, 3 * MS
    aligned_n, in_phase_n = compared_forces_n(now_ns, now_ns - delay_ns, T_NS, RAMP_N, film_age_ns)
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
    assert np.isnan(compared_forces_n(np.array([np.nan]), T_NS[:1], T_NS, RAMP_N)[1]).all()


def test_a_films_readings_are_scored_by_the_time_at_which_they_were_taken() -> None:
    given: list[tuple[Forces, Forces]] = []
    error, age_ns = TrackingError(take_compared=lambda *each: given.append(each[:2])), 7 * MS
    ticks_ns = tick_times_ns(0.5, 3)
    error.begin_session(age_ns)
    add_reference(error, frames(sample_times_ns(2)))
    felt_n = pulse_n(ticks_ns - DELAY_NS - age_ns)
    error.add_output(ticks_ns, ticks_ns, ticks_ns - DELAY_NS, felt_n)
    error.finish()
    assert error.force_rmse_n.aligned == pytest.approx(0, abs=1e-5)
    played_n, scored_n = np.concatenate(given, axis=1)
    np.testing.assert_array_equal(scored_n, felt_n)
    assert np.isnan(played_n[-900:]).all()
    np.testing.assert_allclose(played_n[:1000], felt_n[:1000], atol=1e-5)


def test_errors_on_noise_agree_with_numpy_also_with_a_reference_out_of_order() -> None:
    ticks_ns = tick_times_ns(1.0, 5.5)
    felt_n = pulse_n(ticks_ns) + np.random.default_rng(4).normal(0, 0.03, len(ticks_ns))
    t_ns = sample_times_ns(6.0)
    at_ms = (t_ns - T0_NS) / MS
    aligned_n = felt_n - np.interp((ticks_ns - DELAY_NS - T0_NS) / MS, at_ms, pulse_n(t_ns))
    in_phase_n = felt_n - np.interp((ticks_ns - T0_NS) / MS, at_ms, pulse_n(t_ns))
    shuffled = frames(t_ns)
    np.random.default_rng(1).shuffle(shuffled)
    error, other = scored(ticks_ns, felt_n), scored(ticks_ns, felt_n, shuffled)
    assert error.force_rmse_n.aligned == pytest.approx(rms(aligned_n), rel=1e-9)
    assert error.force_rmse_n.in_phase == pytest.approx(rms(in_phase_n), rel=1e-9)
    assert error.strain_rmse.in_phase == pytest.approx(abs(STRAIN_PER_NEWTON) * rms(in_phase_n))
    within = np.mean(np.abs(aligned_n) < 0.03)
    assert error.within_jnd == pytest.approx(within, abs=1e-3)
    assert (other.force_rmse_n, other.within_jnd) == (error.force_rmse_n, error.within_jnd)


@pytest.mark.parametrize("samples", [0, 1])
def test_without_a_reference_there_are_no_errors(samples: int) -> None:
    reference = [sample_times_ns(0.001)] * samples
    error = scored(tick_times_ns(0.0, 5.0), np.zeros(5000), reference)
    assert error.force_rmse_n.aligned is None
    assert error.strain_rmse.in_phase is None
    assert error.within_jnd is None


@pytest.mark.parametrize(
    ("tick_ms", "late_ms"),
    [(0.1, 250), (1, 250), (1, 4000), (100, 250)],
    ids=["short ticks", "usual ticks", "a slow link", "long ticks"],
)
def test_both_errors_are_known_during_the_run_at_any_length_of_tick_and_delay_of_the_link(
    tick_ms: float, late_ms: int
) -> None:
    tick_ns = round(tick_ms * MS)
    ticks_ns = T0_NS + 1000 * MS + np.arange(10_000 * MS // tick_ns) * tick_ns
    error, pending = TrackingError(STRAIN_PER_NEWTON), frames(sample_times_ns(12.0), 25)
    felt_n = pulse_n(ticks_ns - DELAY_NS)
    for block in np.array_split(np.arange(len(ticks_ns)), 100):
        while pending and pending[0][-1] + late_ms * MS <= ticks_ns[block[-1]]:
            add_reference(error, [pending.pop(0)])
        add_output(error, ticks_ns[block], felt_n[block])
        while error.work():
            pass
    assert error.force_rmse_n.aligned == pytest.approx(0, abs=1e-4)
    expected_n = 0.15 * 2 * math.sin(math.pi * 1.25 * DELAY_NS * 1e-9) / math.sqrt(2)
    assert error.force_rmse_n.in_phase == pytest.approx(expected_n, rel=0.05)


@pytest.mark.parametrize(("gap_ms", "is_scored"), [(50, True), (70, False), (900, False)])
def test_a_long_gap_of_the_reference_is_not_scored(gap_ms: int, is_scored: bool) -> None:
    t_ns = sample_times_ns(6.0)
    gap_ns = (T0_NS + 3000 * MS, T0_NS + (3000 + gap_ms) * MS)
    here = (t_ns <= gap_ns[0]) | (t_ns >= gap_ns[1])
    ticks_ns = tick_times_ns(1.0, 5.0)
    felt_n = pulse_n(ticks_ns)
    felt_n[(ticks_ns > gap_ns[0]) & (ticks_ns < gap_ns[1])] += 100.0
    error = scored(ticks_ns, felt_n, frames(t_ns[here], size=1), delay_ns=0)
    assert error.force_rmse_n.aligned is not None
    assert (error.force_rmse_n.aligned > 1) == is_scored


def test_before_and_after_the_reference_nothing_is_scored() -> None:
    ticks_ns = tick_times_ns(-1.0, 9.0)
    inside = (ticks_ns > T0_NS) & (ticks_ns < T0_NS + 5999 * MS)
    error = scored(ticks_ns, np.where(inside, pulse_n(ticks_ns), 100.0), delay_ns=0)
    assert error.force_rmse_n.aligned == pytest.approx(0, abs=2e-6)
    assert error.force_rmse_n.in_phase == pytest.approx(0, abs=2e-6)


def grown_bytes(run: Callable[[int], None], minutes: int = 10) -> int:
    """Return the growth of memory in bytes from the first minute to the last."""
    tracemalloc.start()
    try:
        run(0)
        after_first, _ = tracemalloc.get_traced_memory()
        for minute in range(1, minutes):
            run(minute)
        return tracemalloc.get_traced_memory()[0] - after_first
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("felt_share", [1.0, 0.3, 0.0], ids=["felt", "a fault after 18 s", "never"])
def test_memory_does_not_grow_in_ten_minutes(felt_share: float) -> None:
    error = TrackingError(STRAIN_PER_NEWTON)
    force_n = np.linspace(0.3, 0.4, 25).tolist()

    def one_minute(minute: int) -> None:
        for frame in range(minute * 2400, (minute + 1) * 2400):
            now_ns = T0_NS + frame * 25 * MS
            t_ns = list(range(now_ns, now_ns + 25 * MS, MS))
            error.add_pulse(t_ns, force_n)
            if felt_share == 1.0 or frame < 2400 * felt_share:
                add_output(error, np.array([now_ns]), np.array([0.3]))

    # The reference of ten minutes has 9.6 MB.
    assert grown_bytes(one_minute) < 500_000
    error.finish()
    assert (error.within_jnd is None) == (felt_share == 0.0)


def test_ticks_do_not_wait_for_a_pulse_that_never_comes() -> None:
    judged: list[int] = []
    error = TrackingError(take_compared=lambda _, felt_n, __: judged.append(len(felt_n)))
    ticks_ns = tick_times_ns(0.0, 30.0)
    add_output(error, ticks_ns, np.zeros(len(ticks_ns)))
    assert 19_000 < sum(judged) <= 20_000
    assert max(judged) == BLOCK


def test_a_force_before_a_fault_is_scored_and_an_unknown_one_is_not() -> None:
    ticks_ns = tick_times_ns(1.0, 2.0)
    pieces = frames(sample_times_ns(120.0))
    felt_n = pulse_n(ticks_ns - DELAY_NS) + 0.01
    error = TrackingError(STRAIN_PER_NEWTON)
    add_reference(error, pieces[:400])
    add_output(error, ticks_ns, felt_n)
    # The fault lasts for two minutes.
    add_reference(error, pieces[400:])
    error.finish()
    felt_n[::7] = math.nan
    for found in (error, scored(ticks_ns, felt_n, pieces[:400])):
        assert found.force_rmse_n.aligned == pytest.approx(0.01, rel=1e-3)


def test_windows_have_the_course_of_delay_and_errors_and_add_up_to_the_whole_run() -> None:
    ticks_ns = tick_times_ns(1.0, 41.0)
    felt_n = pulse_n(ticks_ns - DELAY_NS)
    felt_n[20_000:] = pulse_n(ticks_ns[20_000:]) + 0.002
    error = TrackingError(STRAIN_PER_NEWTON)
    pieces = frames(sample_times_ns(42.0), 1000)
    add_reference(error, pieces[:22])
    add_output(error, ticks_ns[:20_000], felt_n[:20_000])
    add_reference(error, pieces[22:])
    add_output(error, ticks_ns[20_000:], felt_n[20_000:], delay_ns=0)
    error.finish()
    windows = error.windows
    times_s = [(each.from_s, each.to_s) for each in windows]
    assert times_s[:15] == [(second, second + 1) for second in range(15)]
    assert times_s[15:] == [(15, 30), (30, pytest.approx(39.999))]
    assert windows[0].playout_delay_ms == pytest.approx(43)
    assert windows[0].aligned_n == pytest.approx(0, abs=2e-6)
    # 5 s of 15 s are played with a delay.
    assert windows[15].playout_delay_ms == pytest.approx(43 / 3)
    assert windows[16].aligned_n == windows[16].in_phase_n == pytest.approx(0.002, rel=1e-3)
    for name in ("aligned", "in_phase"):
        squares = (getattr(w, f"{name}_n") ** 2 * (w.to_s - w.from_s) for w in windows)
        whole = getattr(error.force_rmse_n, name)
        assert math.sqrt(sum(squares) / 40) == pytest.approx(whole, rel=1e-3)


def test_a_window_without_a_known_error_reports_its_delay() -> None:
    ticks_ns = tick_times_ns(1.0, 2.0)
    error = TrackingError(STRAIN_PER_NEWTON)
    # The reference ends before the run does.
    add_reference(error, frames(sample_times_ns(1.2)))
    add_output(error, ticks_ns, pulse_n(ticks_ns), delay_ns=500 * MS)
    error.finish()
    (window,) = error.windows
    assert window.playout_delay_ms == pytest.approx(500)
    assert window.aligned_n is not None
    assert windows_text([[asdict(window)]]) is not None
    add_output(error, ticks_ns + 20_000 * MS, pulse_n(ticks_ns))
    error.finish()
    text = windows_text([[asdict(each) for each in error.windows]])
    assert text is not None
    assert text.splitlines()[1] == "15 to 21 s: E 43.0 ms, aligned unknown, in phase unknown"


@pytest.mark.parametrize("stepped_s", [-3600, -4, 0, 3600, 72 * 3600])
def test_ticks_of_two_sessions_are_all_judged_however_far_apart_their_clocks_are(
    stepped_s: int,
) -> None:
    under_test, step_ns = display(), stepped_s * 1000 * MS
    run(under_test, Sender(), 0, 5000)
    # The sensing host boots again: another session, by another clock.
    under_test.receiver.introduce()
    restarted = Sender(session=8)
    for ms in range(5000, 9000):
        while under_test.work():
            pass
        under_test.tick(ms * MS)
        restarted.serve(under_test, ms * MS, step_ns=step_ns)
        if ms % 5 == 0:
            under_test.on_frame(restarted.frame(ms * MS + step_ns, 0.3), ms * MS)
    under_test.finish_scores()
    summary = under_test.summary(0)
    assert under_test.receiver.sessions == 2
    assert summary.availability.judged == summary.availability.felt
    assert summary.availability.judged == pytest.approx(0.877, abs=0.01)
    # By the display's clock, which did not step.
    assert [each.from_s for each in summary.windows] == list(range(9))


def test_a_session_is_judged_by_its_own_pulse_where_clocks_overlap() -> None:
    ticks_ns = tick_times_ns(1.0, 5.5)
    felt_n = pulse_n(ticks_ns - DELAY_NS)
    error = TrackingError(STRAIN_PER_NEWTON)
    for number in range(2):
        error.begin_session()
        for t_ns in frames(sample_times_ns(6.0)):
            error.add_pulse(t_ns.tolist(), (pulse_n(t_ns) + number).tolist())
        now_ns = ticks_ns + 10_000 * MS * number
        error.add_output(now_ns, ticks_ns, ticks_ns - DELAY_NS, felt_n + number + 0.02)
    error.finish()
    assert error.force_rmse_n.aligned == pytest.approx(0.02, rel=1e-3)
    # The JND is of 0.3 N, not of the step from one session's pulse to the other's.
    assert error.within_jnd == 1.0
    assert [each.to_s - each.from_s for each in error.windows[:4]] == [1.0] * 4


def test_a_session_that_is_replaced_before_any_of_its_pulse_is_known_has_no_errors() -> None:
    ticks_ns = tick_times_ns(1.0, 2.0)
    error = TrackingError(STRAIN_PER_NEWTON)
    error.begin_session()
    add_output(error, ticks_ns, pulse_n(ticks_ns))
    error.begin_session()
    add_reference(error, frames(sample_times_ns(6.0)))
    error.finish()
    assert error.force_rmse_n.aligned is None
    assert error.within_jnd is None
