import numpy as np
import pytest

from display_node.prediction.grid import MAX_GAP_NS, STEP_NS, Grid, GridCell
from tests.support.pulse_signals import MS, T0_NS


def cells(grid: Grid) -> list[GridCell]:
    taken = list(grid.fresh)
    grid.fresh.clear()
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


def test_a_frame_of_5_ms_completes_a_cell_at_once() -> None:
    grid = Grid()
    for frame in range(4):
        times_ns = [T0_NS + (5 * frame + number) * MS for number in range(5)]
        observe_line(grid, times_ns)
        assert [cell.end_ns for cell in cells(grid)] == ([times_ns[-1]] if frame else [])


def test_noise_is_averaged() -> None:
    rng, grid = np.random.default_rng(1), Grid()
    for frame in range(400):
        times_ns = [T0_NS + (5 * frame + number) * MS for number in range(5)]
        grid.observe(times_ns, rng.standard_normal(5).tolist())
    assert np.std([cell.value for cell in cells(grid)]) < 0.6


def test_what_was_guessed_is_corrected_by_late_samples() -> None:
    def bump(t_ns: int) -> float:
        return 1.0 if 100 * MS <= t_ns - T0_NS < 110 * MS else 0.0

    whole, late = Grid(), Grid()
    frames = [[T0_NS + (5 * frame + number) * MS for number in range(5)] for frame in range(40)]
    for times_ns in frames:
        whole.observe(times_ns, [bump(t_ns) for t_ns in times_ns])
    for times_ns in [*frames[:20], *frames[22:]]:
        late.observe(times_ns, [bump(t_ns) for t_ns in times_ns])
    expected, guessed = cells(whole), cells(late)
    assert [cell.end_ns for cell in guessed] == [cell.end_ns for cell in expected]
    assert guessed != expected
    for times_ns in (frames[21], frames[20]):
        late.observe(times_ns, [bump(t_ns) for t_ns in times_ns])
    mended = {cell.number: cell for cell in guessed} | {cell.number: cell for cell in late.late}
    assert list(mended.values()) == expected


def test_a_late_sample_corrects_a_cell_that_still_waits() -> None:
    grid = Grid()
    for first in (0, 5, 15):
        grid.observe([T0_NS + (first + number) * MS for number in range(5)], [0.0] * 5)
    grid.observe([T0_NS + (10 + number) * MS for number in range(5)], [1.0] * 5)
    assert grid.late == []
    assert [cell.value for cell in cells(grid)] == pytest.approx([0.1, 0.9, 0.0], abs=0.11)


def test_a_long_gap_is_left_out() -> None:
    grid = Grid()
    observe_line(grid, [T0_NS + number * MS for number in range(21)])
    far_ns = T0_NS + 21 * MS + MAX_GAP_NS
    observe_line(grid, [far_ns + number * MS for number in range(21)])
    ends_ns = [cell.end_ns for cell in cells(grid)]
    assert ends_ns == [far_ns + 5 * MS * number for number in range(1, 5)]


def test_samples_from_before_all_that_is_kept_change_nothing() -> None:
    grid = Grid()
    observe_line(grid, [T0_NS + number * MS for number in range(50)])
    cells(grid)
    grid.observe([T0_NS - 30 * MS], [99.0])
    assert cells(grid) == []
    assert grid.late == []
