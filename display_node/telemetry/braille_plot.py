"""A small plot for terminals: a curve as a line over one as dots, in braille characters. Pure."""

import math
from collections.abc import Sequence

import numpy as np
from rich.console import RenderableType
from rich.text import Text

COLUMNS, ROWS = 64, 6
BRAILLE_BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


def limits(*curves: Sequence[float]) -> tuple[float, float] | None:
    """Return the least and the greatest value of all curves; None where there is no number."""
    known = [value for curve in curves for value in curve if math.isfinite(value)]
    return (min(known), max(known)) if known else None


def braille_plot(
    line: Sequence[float], dots: Sequence[float], low: float, high: float, style: str = "cyan"
) -> list[RenderableType]:
    """Draw two curves of finite values or NaN; a NaN is a gap.

    low, high: what the lowest and the highest row stand for. Returns a text for each row of
    characters, each of 2 × 4 dots.
    """
    columns, rows = 2 * COLUMNS, 4 * ROWS
    cells = [[0] * COLUMNS for _ in range(ROWS)]
    line_y, dots_y = (_heights(curve, columns, rows, low, high) for curve in (line, dots))
    for x in range(columns):
        before, here, dot = line_y[max(x - 1, 0)], line_y[x], dots_y[x]
        marked = set[int]()
        if here is not None:
            # The line runs down or up to where the column before it ended.
            before = here if before is None else before
            marked.update(range(min(before + 1, here), max(before, here + 1)))
        if x % 3 == 0 and dot is not None:
            marked.add(dot)
        for y in marked:
            cells[y // 4][x // 2] |= BRAILLE_BITS[x % 2][y % 4]
    return [Text("".join(chr(0x2800 + cell) for cell in row), style) for row in cells]


def _heights(
    curve: Sequence[float], columns: int, rows: int, low: float, high: float
) -> list[int | None]:
    """Return the curve at each column as a row counted from the top, None in a gap."""
    at = np.interp(np.linspace(0, len(curve) - 1, columns), np.arange(len(curve)), curve)
    share = (at - low) / (high - low) if high > low else np.where(np.isnan(at), at, 0.0)
    return [
        None if math.isnan(part) else rows - 1 - round(min(max(part, 0.0), 1.0) * (rows - 1))
        for part in share.tolist()
    ]
