"""Plots of the page in Bokeh.

Colours of axes and grids come from the page's style sheet, light or dark; those of the curves are
legible on both.
"""

from typing import NamedTuple

import numpy as np
from bokeh.models import BasicTicker, ColumnDataSource, Range1d
from bokeh.models.annotations import BoxAnnotation
from bokeh.plotting import figure
from numpy.typing import NDArray

from telepulse.view.picture import Columns, Picture

SENSED, FELT, MUTED = "#e8740c", "#2f7fd6", "#8a94a0"
HEIGHT = 220


class Curve(NamedTuple):
    """A curve; name: of its columns in a picture; words: in the legend."""

    name: str
    words: str
    colour: str
    dash: str = "solid"


class PagePlot(NamedTuple):
    """A plot; id: on the page; axis: label; note: a line beneath."""

    id: str
    title: str
    axis: str
    curves: tuple[Curve, ...]
    note: str = ""
    wide: bool = False


PLOTS = (
    PagePlot(
        "force",
        "Force",
        "force (mN)",
        (Curve("wrist", "at the wrist", SENSED), Curve("finger", "at the finger", FELT)),
        "The finger follows by the playout delay.",
        wide=True,
    ),
    PagePlot(
        "error",
        "Error of the force felt",
        "error (mN)",
        (
            Curve("in_phase", "in phase: against the pulse at that instant", SENSED),
            Curve("aligned", "aligned: against the instant that is played", FELT),
        ),
        "Grey band: the just noticeable difference of force, here 10 % of the pulse's peak to peak."
        " A finger notices differences from 7 to 10 % on.",
        wide=True,
    ),
    PagePlot(
        "strain",
        "Compressive strain in the rubber",
        "strain (10⁻⁶)",
        (
            Curve("wrist_strain", "at the wrist", SENSED),
            Curve("finger_strain", "at the finger", FELT),
        ),
    ),
    PagePlot(
        "delay",
        "Delays",
        "delay (ms)",
        (Curve("one_way", "one-way delay", SENSED), Curve("playout", "playout delay", FELT)),
    ),
    PagePlot(
        "loss",
        "Loss",
        "samples (%)",
        (Curve("lost", "lost", SENSED), Curve("late", "late", FELT, "dashed")),
    ),
    PagePlot(
        "predictor",
        "Predictor: the error it expects",
        "RMS error (mN)",
        (Curve("predictor", "where it stands in", FELT),),
    ),
    PagePlot(
        "offset",
        "Clock offset, against now",
        "offset (ms)",
        (
            Curve("offset", "offset", FELT),
            Curve("offset_low", "uncertainty", MUTED, "dashed"),
            Curve("offset_high", "", MUTED, "dashed"),
        ),
    ),
    PagePlot("skew", "Clock skew", "skew (ppm)", (Curve("skew", "sensing against display", FELT),)),
)


_CURVES = tuple(curve.name for plot in PLOTS for curve in plot.curves)
_NOTHING: Columns = {"t": np.empty(0), "y": np.empty(0)}


class Plots:
    """Plots of one viewer; roots: their Bokeh models, each named by its id."""

    def __init__(self) -> None:
        # One source, so that a picture is one message and each plot is painted once.
        self._source = ColumnDataSource(padded(dict.fromkeys(_CURVES, _NOTHING)))
        self._times = Range1d(start=-10, end=0)
        self._limits = {plot.id: Range1d(start=0, end=1) for plot in PLOTS}
        self._band = BoxAnnotation(
            bottom=0, top=0, fill_color=MUTED, fill_alpha=0.25, line_alpha=0, level="underlay"
        )
        self.roots = [self._draw(plot) for plot in PLOTS]

    def show(self, picture: Picture, window_s: float) -> None:
        """Draw a picture."""
        self._times.start = -window_s
        self._source.data = padded(picture.columns)
        for plot, (low, high) in picture.limits.items():
            self._limits[plot].update(start=low, end=high)
        jnd_mn = (picture.scores.jnd_n or 0.0) * 1e3
        self._band.update(bottom=-jnd_mn, top=jnd_mn)

    def _draw(self, plot: PagePlot) -> figure:
        drawn = figure(
            name=plot.id,
            height=HEIGHT,
            sizing_mode="stretch_width",
            x_range=self._times,
            y_range=self._limits[plot.id],
            x_axis_label="time from now (s)",
            y_axis_label=plot.axis,
            tools="",
            toolbar_location=None,
            min_border_right=14,
            background_fill_color=None,
            border_fill_color=None,
            outline_line_color=None,
        )
        drawn.axis.minor_tick_line_color = None
        drawn.axis.axis_label_text_font_style = "normal"
        drawn.axis.axis_label_text_font_size = drawn.axis.major_label_text_font_size = "13px"
        drawn.xaxis.ticker, drawn.yaxis.ticker = (
            BasicTicker(desired_num_ticks=count) for count in (6, 5)
        )
        for curve in plot.curves:
            drawn.line(
                *(f"{curve.name}_t", f"{curve.name}_y"),
                source=self._source,
                line_color=curve.colour,
                line_dash=curve.dash,
                line_width=2,
            )
        if plot.id == "error":
            drawn.add_layout(self._band)
        return drawn


def padded(columns: dict[str, Columns]) -> dict[str, NDArray[np.float32]]:
    """Return all curves as columns of one length, padded with NaN."""
    length = max(len(columns[name]["t"]) for name in _CURVES)
    padded = {}
    for name in _CURVES:
        for axis, values in columns[name].items():
            column = padded[f"{name}_{axis}"] = np.full(length, np.nan, np.float32)
            column[: len(values)] = values
    return padded
