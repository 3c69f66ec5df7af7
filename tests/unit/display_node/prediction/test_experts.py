import numpy as np
import pytest

from display_node.prediction.analogue import Analogue
from display_node.prediction.distances import (
    ANALOGUES,
    COUNTS,
    FIRSTS,
    FORGETS,
    LAGS,
    NEAREST,
    find_analogues,
)
from display_node.prediction.expert import AHEAD
from display_node.prediction.fir import Fir
from display_node.prediction.grid import MAX_GAP_NS, STEP_NS, Grid, GridCell, Rhythm
from display_node.prediction.history import History, mean_about
from tests.unit.display_node.prediction.pulse_signals import MS, T0_NS, beats, expert_errors


def cells(grid: Grid) -> list[GridCell]:
    taken = list(grid.new_cells)
    grid.new_cells.clear()
    return taken


def line(t_ns: int) -> float:
    return 0.3 + (t_ns - T0_NS) / (40 * MS)


def observe_line(grid: Grid, times_ns: list[int]) -> None:
    grid.observe(times_ns, [line(t_ns) for t_ns in times_ns])


@pytest.mark.parametrize("period_ns", [250_000, MS, 3 * MS, 8_333_333, 20 * MS])
@pytest.mark.parametrize("frame", [1, 5, 7])
def test_a_straight_line_stays_one_at_any_rate(period_ns: int, frame: int) -> None:
    grid = Grid()
    for first in range(0, 140, frame):
        numbers = range(first, first + frame)
        observe_line(grid, [T0_NS + number * period_ns for number in numbers])
    taken = cells(grid)
    assert len(taken) > 0.8 * 140 * period_ns / STEP_NS - frame * period_ns / STEP_NS - 1
    assert [cell.number for cell in taken] == list(range(len(taken)))
    for cell in taken:
        assert cell.value == pytest.approx(line(cell.end_ns - STEP_NS // 2), abs=1e-9)
        assert cell.ends == pytest.approx(line(cell.end_ns), abs=1e-9)
    # A frame's last cell knows of no sample after it, and is continued.
    for cell in taken[1:]:
        assert cell.continues == pytest.approx(line(cell.end_ns + STEP_NS), abs=1e-9)


def test_the_last_cell_of_the_samples_that_complete_it_is_the_newest() -> None:
    grid = Grid()
    observe_line(grid, [T0_NS])
    observe_line(grid, [T0_NS + 17 * MS])
    observe_line(grid, [T0_NS + 19 * MS])
    observe_line(grid, [T0_NS + 24 * MS])
    assert [cell.newest for cell in cells(grid)] == [False, False, True, True]


def test_a_frame_of_5_ms_completes_a_cell_at_once_and_noise_is_averaged() -> None:
    rng, grid, taken = np.random.default_rng(1), Grid(), []
    for frame in range(400):
        grid.observe(times_of(frame), rng.standard_normal(5).tolist())
        completed = cells(grid)
        assert [cell.end_ns for cell in completed] == ([times_of(frame)[-1]] if frame else [])
        taken += completed
    assert np.std([cell.value for cell in taken]) < 0.6


def times_of(frame: int) -> list[int]:
    """Return the times of a frame of 5 samples at 1 kHz."""
    return [T0_NS + (5 * frame + number) * MS for number in range(5)]


def test_late_samples_correct_interpolated_cells() -> None:
    whole, late = Grid(), Grid()
    values = {frame: [float(frame in (20, 21))] * 5 for frame in range(40)}
    for frame in range(40):
        whole.observe(times_of(frame), values[frame])
        if frame not in (20, 21):
            late.observe(times_of(frame), values[frame])
    expected, interpolated = cells(whole), cells(late)
    assert [cell.end_ns for cell in interpolated] == [cell.end_ns for cell in expected]
    assert interpolated != expected
    for frame in (21, 20):
        late.observe(times_of(frame), values[frame])
    corrected = {cell.number: cell for cell in (*interpolated, *late.corrections)}
    assert [cell[:3] for cell in corrected.values()] == [cell[:3] for cell in expected]


def test_a_late_sample_corrects_a_cell_that_still_waits() -> None:
    grid = Grid()
    for frame in (0, 1, 3):
        grid.observe(times_of(frame), [0.0] * 5)
    grid.observe(times_of(2), [1.0] * 5)
    assert grid.corrections == []
    assert [cell.value for cell in cells(grid)] == pytest.approx([0.1, 0.9, 0.0], abs=0.11)


def test_a_long_gap_has_no_cells_and_samples_from_before_it_change_nothing() -> None:
    grid = Grid()
    observe_line(grid, [T0_NS + number * MS for number in range(21)])
    far_ns = T0_NS + 21 * MS + MAX_GAP_NS
    observe_line(grid, [far_ns + number * MS for number in range(21)])
    ends_ns = [cell.end_ns for cell in cells(grid)]
    assert ends_ns == [far_ns + 5 * MS * number for number in range(1, 5)]
    grid.observe([T0_NS - 30 * MS], [99.0])
    assert cells(grid) == grid.corrections == []


T_S = np.arange(6_000) * 0.005


def test_fir_learns_a_sum_of_sinusoids() -> None:
    signal = sum((np.sin(2 * np.pi * hz * T_S + hz) for hz in (0.9, 2.3, 6.1)), np.zeros(6_000))
    assert expert_errors(Fir(), signal, from_step=4_000).max() < 5e-3


def test_analogue_continues_a_beat_also_where_its_period_is_no_whole_number_of_steps() -> None:
    *means, _ = expert_errors(Analogue(), beats(T_S[:3_000]), from_step=2_000)
    assert means[-1].max() < 0.01
    signal = beats(T_S[:4_000], intervals_s=(0.8033,))
    *means, _ = expert_errors(Analogue(), signal, from_step=3_000)
    assert means[-1].max() < 0.06


def test_a_regression_is_as_good_at_the_steps_for_which_it_was_made_as_at_the_next_ones() -> None:
    signal = beats(T_S[:4_000]) + 3e-3 * np.random.default_rng(1).standard_normal(4_000)
    expert, history, made = Analogue(), History(8_192), np.zeros((4, 1, len(AHEAD)))
    squares: tuple[list[float], list[float]] = ([], [])
    for step, value in enumerate(signal[:-200].tolist()):
        history.push(value)
        expert.predict(history, made)
        expert.prepare(history)
        if step >= 3_000:
            errors = value + made[-1, 0] - beats(T_S[:4_000])[step + AHEAD]
            squares[step % 2].append(float(np.mean(errors**2)))
    first, next_one = (np.sqrt(np.mean(each)) for each in squares)
    assert max(first, next_one) < 2 * min(first, next_one)


def test_a_regression_continues_what_no_analogue_equals() -> None:
    signal = np.sin(2 * np.pi * 0.9 * T_S) * np.sin(2 * np.pi * 0.07 * T_S)
    mean, *_, regression = expert_errors(Analogue(), signal, from_step=4_000)
    assert regression.max() < 0.3 * mean.max()


@pytest.mark.parametrize("interval_s", [0.4, 0.8, 1.5])
def test_rhythm_finds_the_interval(interval_s: float) -> None:
    t_s = np.arange(3_000) * 0.005
    rhythm, signal = Rhythm(), beats(t_s, (interval_s,))
    for _ in range(2_000):
        rhythm.push(0.0)
    assert rhythm.interval is None
    rhythm = Rhythm()
    for before, after in zip(signal[:-2].tolist(), signal[2:].tolist(), strict=True):
        rhythm.push(after - before)
    assert rhythm.interval == pytest.approx(interval_s / 0.005, abs=1)


def test_history_keeps_the_newest_values_and_rewrites_them() -> None:
    history, all_values = History(100), np.random.default_rng(1).standard_normal(1_234)
    for value in all_values.tolist():
        history.push(value)
    np.testing.assert_array_equal(history.last(100), all_values[-100:].astype(np.float32))
    history.rewrite(3, 7.0)
    history.rewrite(100, 8.0)
    assert history.last(4)[0] == 7.0
    assert 8.0 not in history.last(100)


def test_means_of_the_history_follow_late_samples_and_outlast_its_buffer() -> None:
    history, rng = History(100), np.random.default_rng(1)
    for value in rng.standard_normal(1_234).tolist():
        history.push(value)
        if history.count % 7 == 0:
            history.rewrite(5, value + 1.0)
    middle = history.end - 11
    for width in (0, 1, 10):
        values = history.buffer[0, middle - width : middle + width + 1]
        expected = values.mean(dtype=np.float64)
        assert mean_about(history.sums, middle, width) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("lost", [0, 1, 12])
def test_analogues_are_the_lowest_minima_also_where_some_were_lost(lost: int) -> None:
    rng = np.random.default_rng(lost)
    noise = np.convolve(rng.random(LAGS + 40), np.ones(40) / 40, "valid")[:LAGS]
    distances = np.tile(np.square(noise - noise.min() + 0.01), (3, 1)).astype(np.float32)
    row, first = distances[0], 300
    inner = np.arange(first + 1, LAGS - NEAREST)
    minima = inner[(row[inner] < row[inner - 1]) & (row[inner] <= row[inner + 1])]
    lowest = minima[np.argsort(row[minima], kind="stable")]
    places, nearest = np.zeros(ANALOGUES, np.int64), np.zeros(ANALOGUES, np.float32)
    for begin, count in zip(FIRSTS, COUNTS, strict=True):
        places[begin : begin + count] = lowest[:count]
        # Those that have become one with another.
        places[begin + count - lost : begin + count] = lowest[0]
    assert find_analogues(distances, first, FORGETS, places, nearest)
    for begin, count in zip(FIRSTS, COUNTS, strict=True):
        np.testing.assert_array_equal(places[begin : begin + count], lowest[:count])


def test_rhythm_ignores_the_second_wave_of_a_beat_and_recovers_from_an_artefact() -> None:
    t_s = np.arange(6_000) * 0.005
    slopes = np.gradient(beats(t_s, (1.5,)))
    rhythm = Rhythm()
    # The first wave seen is the second one of its beat.
    for slope in slopes[50:3_000].tolist():
        rhythm.push(slope)
    assert rhythm.interval == pytest.approx(300, abs=1)
    for _ in range(3):
        for slope in (0.0, 50.0, 0.0, *[0.0] * 60):
            rhythm.push(slope)
    for slope in slopes[3_000:].tolist():
        rhythm.push(slope)
    assert rhythm.interval == pytest.approx(300, abs=1)
