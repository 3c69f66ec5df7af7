"""Pictures of a report's plots: drawn light and dark, wide and narrow, with matplotlib."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from telepulse.reports.notation import typeset

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Theme(NamedTuple):
    """Colours of a plot. Line colours also differ in lightness."""

    name: str
    ground: str
    ink: str
    faint: str
    lines: str


THEMES = (
    Theme("light", "#ffffff", "#1d2329", "#d5dae0", "#1f5fa8 #d1570b #1f8a5b #8d3fb0 #9a7200"),
    Theme("dark", "#14181d", "#e4e8ec", "#353d46", "#6fb1ff #ff9d5c #5fd3a0 #cf9bf0 #e8c765"),
)


class FigureSize(NamedTuple):
    """A size of plots; media: where the page shows it, as a condition of CSS."""

    suffix: str
    inches: tuple[float, float]
    media: str

    @property
    def pixels(self) -> tuple[int, int]:
        """Width and height of the picture."""
        width, height = self.inches
        return round(width * DPI), round(height * DPI)


DPI = 144
# On a phone a picture is 358 px wide; letters of 10 pt then have 10 px in the narrow one.
NARROW = FigureSize("-narrow", (4.8, 5.0), "(max-width: 40rem)")
SIZES = (NARROW, FigureSize("", (8.0, 4.5), "(min-width: 0)"))


def draw_picture(
    draw: "Callable[[Figure], None]", theme: Theme, size: FigureSize, path: Path
) -> None:
    """Write a picture of a theme and a size; `draw` fills an empty figure."""
    import matplotlib
    from cycler import cycler
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    from telepulse.reports.narrow import NarrowFigure

    style: Any = {
        "figure.facecolor": theme.ground,
        "axes.facecolor": theme.ground,
        "savefig.facecolor": theme.ground,
        "axes.edgecolor": theme.ink,
        "axes.labelcolor": theme.ink,
        "text.color": theme.ink,
        "xtick.color": theme.ink,
        "ytick.color": theme.ink,
        "grid.color": theme.faint,
        "legend.frameon": False,
        "axes.grid": True,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.prop_cycle": cycler(color=theme.lines.split()),
        "font.size": 12,
        "lines.linewidth": 1.8,
    }
    with matplotlib.rc_context(style):
        kind = NarrowFigure if size is NARROW else Figure
        figure = kind(figsize=size.inches, layout="constrained")
        draw(figure)
        for text in figure.findobj(Text):
            # What is between dollar signs is set by matplotlib itself.
            if isinstance(text, Text) and "$" not in text.get_text():
                text.set_text(typeset(text.get_text()))
        if isinstance(figure, NarrowFigure):
            figure.fit()
        figure.savefig(path, dpi=DPI)
