import pytest

from display_node.plant.filters import DelayLine


@pytest.mark.parametrize(
    ("ticks", "expected"),
    [
        (0, [1, 2, 4, 8, 16]),
        (1, [0, 1, 2, 4, 8]),
        (3, [0, 0, 0, 1, 2]),
        (0.25, [0.75, 1.75, 3.5, 7, 14]),
        (1.5, [0, 0.5, 1.5, 3, 6]),
    ],
)
def test_values_come_back_so_many_ticks_later(ticks: float, expected: list[float]) -> None:
    delay = DelayLine(ticks)
    assert [delay.step(value) for value in (1, 2, 4, 8, 16)] == expected
