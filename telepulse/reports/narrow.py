"""Figures for a phone: panels below each other, and legends no wider than the figure."""

from textwrap import fill
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import GridSpec
from matplotlib.legend import Legend

# Of the width of a figure, at most for its legend.
LEGEND_SHARE = 0.9
# Letters in a line of a label below an axis.
LABEL_LETTERS = 40
# Height of stacked panels, as a multiple of that of a figure.
HIGHER = 1.5


class NarrowAxes(Axes):
    """Axes whose legend has as many columns as there is room for."""

    def legend(self, *args: Any, ncols: int = 1, **options: Any) -> Legend:
        """Add a legend with at most `ncols` columns."""
        made = super().legend(*args, ncols=ncols, **options)
        while ncols > 1 and _too_wide(made):
            ncols -= 1
            made = super().legend(*args, ncols=ncols, **options)
        return made


class NarrowFigure(Figure):
    """A figure for a phone, which is used as any other."""

    def add_subplot(self, *args: Any, **options: Any) -> Any:
        """Add axes of the narrow kind."""
        return super().add_subplot(*args, **({"axes_class": NarrowAxes} | options))

    def legend(self, *args: Any, ncols: int = 1, **options: Any) -> Legend:
        """Add a legend with at most `ncols` columns."""
        made = super().legend(*args, ncols=ncols, **options)
        while ncols > 1 and _too_wide(made):
            ncols -= 1
            made.remove()
            made = super().legend(*args, ncols=ncols, **options)
        return made

    def fit(self) -> None:
        """Break long labels, and put panels side by side below each other, in a higher figure."""
        for axes in self.axes:
            axes.set_xlabel(fill(axes.get_xlabel(), LABEL_LETTERS))
        stacked: dict[int, GridSpec] = {}
        for axes in self.axes:
            place = axes.get_subplotspec()
            grid = None if place is None else place.get_gridspec()
            if place is None or grid is None or grid.nrows > 1 or grid.ncols == 1:
                continue
            rows = stacked.setdefault(id(grid), GridSpec(grid.ncols, 1, figure=self))
            axes.set_subplotspec(rows[place.colspan.start])
            # Panels that share an axis have its labels at the first one only.
            axes.tick_params(labelleft=True)
            axes.set_ylabel(axes.get_ylabel() or self.axes[0].get_ylabel())
        if stacked:
            width, height = self.get_size_inches()
            self.set_size_inches(width, HIGHER * height)


def _too_wide(legend: Legend) -> bool:
    figure = legend.get_figure(root=True)
    assert figure is not None
    return bool(legend.get_window_extent().width > LEGEND_SHARE * figure.bbox.width)
