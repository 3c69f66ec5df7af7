"""Plot of two curves in a terminal, by characters of 2 × 4 dots. Pure."""

import math
from collections.abc import Sequence

import numpy as np

PLOT_COLUMNS, PLOT_ROWS = 64, 6
BRAILLE_BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


def braille_plot(
    line: Sequence[float], dots: Sequence[float], low: float, high: float
) -> list[str]:
    """Draw two curves as rows of characters, each of 2 × 4 dots; NaN is a gap.

    low, high: values of the lowest and the highest row of dots.
    """
    columns, rows = 2 * PLOT_COLUMNS, 4 * PLOT_ROWS

    def heights(curve: Sequence[float]) -> list[int | None]:
        """Return the curve at each column as a row counted from the top, None in a gap."""
        at = np.interp(np.linspace(0, len(curve) - 1, columns), np.arange(len(curve)), curve)
        share = (at - low) / (high - low) if high > low else np.where(np.isnan(at), at, 0.0)
        return [
            None if math.isnan(part) else rows - 1 - round(min(max(part, 0.0), 1.0) * (rows - 1))
            for part in share.tolist()
        ]

    marked = np.zeros((rows, columns), int)
    line_y, dots_y = heights(line), heights(dots)
    for x, (here, dot) in enumerate(zip(line_y, dots_y, strict=True)):
        if here is not None:
            # A vertical stroke joins the line to its end in the column before.
            before = line_y[max(x - 1, 0)]
            before = here if before is None else before
            marked[min(before + 1, here) : max(before, here + 1), x] = 1
        if x % 3 == 0 and dot is not None:
            marked[dot, x] = 1
    cells = marked.reshape(PLOT_ROWS, 4, PLOT_COLUMNS, 2)
    characters = 0x2800 + np.einsum("rycx,xy->rc", cells, BRAILLE_BITS)
    return ["".join(map(chr, row)) for row in characters.tolist()]
