"""The page as a Bokeh document, one for each viewer, and its plots.

Colours of axes and grids come from the page's style sheet, light or dark; those of the curves are
legible on both.
"""

from collections.abc import Callable
from functools import cache
from importlib.resources import files
from itertools import product
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import ConnectionLost, DocumentReady
from bokeh.models import (
    BasicTicker,
    ColumnDataSource,
    CustomJS,
    PanTool,
    Range1d,
    WheelZoomTool,
)
from bokeh.models.annotations import BoxAnnotation
from bokeh.plotting import figure
from jinja2 import Template
from numpy.typing import NDArray

from telepulse.view import text
from telepulse.view.live import LISTED_EVENTS, LiveState
from telepulse.view.plots import EVENT_LINES, FINGER_COLOURS, FINGERS, MUTED, PLOTS, PagePlot
from telepulse.view.window_data import Columns, WindowData, window_data

REDRAW_MS = 200
WINDOWS_S = (5, 10, 30, 60)
WINDOW_S = 10
SECOND_NS = 1_000_000_000
# Runs in the browser when the connection to the server is lost: the page keeps the last state.
SERVER_LOST = """
document.getElementById("state").textContent = "ended";
document.getElementById("state").dataset.state = "ended";
document.getElementById("state-note").textContent =
  "the server of this page has ended: it shows the last state";
"""
HEIGHT = 220
_CURVES = tuple(curve.name for plot in PLOTS for curve in plot.curves)


class Plots:
    """Plots of one viewer.

    roots: their Bokeh models, each named by its id. sources: the data of the curves, of the curves
    of several fingers, and of the events.
    """

    def __init__(self) -> None:
        # One source, so that an update is one message and each plot is drawn once.
        empty: dict[str, list[float]] = {
            f"{name}_{axis}": [] for name in _CURVES for axis in ("t", "y")
        }
        self._source = ColumnDataSource(empty)
        # One row a contactor; empty for an only one.
        self._fingers = ColumnDataSource({"t": [], "y": [], "colour": []})
        columns = ("t", "text", "colour", "dash", "width")
        self._events = ColumnDataSource(dict[str, Any]({name: [] for name in columns}))
        self.sources = {"curves": self._source, "fingers": self._fingers, "events": self._events}
        self._times, self._forces = Range1d(start=-10, end=0), Range1d(start=0, end=1)
        self._limits = {plot.id: Range1d(start=0, end=1) for plot in (*PLOTS, FINGERS)}
        self._band = BoxAnnotation(
            bottom=0, top=0, fill_color=MUTED, fill_alpha=0.25, line_alpha=0, level="underlay"
        )
        self.roots = [self._draw(plot) for plot in (*PLOTS, FINGERS)]

    def show(self, data: WindowData) -> None:
        """Draw the curves of a window."""
        # The end as well: a reader may have zoomed in a pause.
        self._times.update(start=-data.window_s, end=0)
        self._forces.update(start=data.force_n[0], end=data.force_n[1])
        self._source.data = padded(data.columns)
        lines = [EVENT_LINES[kind] for _, kind, _ in data.events]
        self._events.data = {
            "t": [time_s for time_s, _, _ in data.events],
            "text": [text for _, _, text in data.events],
            "colour": [line.colour for line in lines],
            "dash": [line.dash for line in lines],
            "width": [line.width for line in lines],
        }
        for plot, (low, high) in data.limits.items():
            self._limits[plot].update(start=low, end=high)
        jnd_mn = (data.scores.jnd_n or 0.0) * 1e3
        self._band.update(bottom=-jnd_mn, top=jnd_mn)
        if data.fingers or self._fingers.data["colour"]:
            curves = {axis: [finger[axis] for finger in data.fingers] for axis in ("t", "y")}
            colours = list(FINGER_COLOURS[: len(data.fingers)])
            self._fingers.data = curves | {"colour": colours}

    def _draw(self, plot: PagePlot) -> figure:
        drawn = figure(
            name=plot.id,
            height=HEIGHT,
            sizing_mode="stretch_width",
            x_range=self._forces if plot.across else self._times,
            y_range=self._limits[plot.id],
            x_axis_label=plot.across or "time from now (s)",
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
            columns = f"{curve.name}_t", f"{curve.name}_y"
            if curve.marker:
                drawn.scatter(
                    *columns,
                    source=self._source,
                    marker=curve.marker,
                    size=9,
                    line_color=curve.colour,
                    line_width=2,
                    fill_color=None,
                )
            else:
                drawn.line(
                    *columns,
                    source=self._source,
                    line_color=curve.colour,
                    line_dash=curve.dash,
                    line_width=2,
                )
        if plot.id == FINGERS.id:
            drawn.multi_line("t", "y", source=self._fingers, line_color="colour", line_width=2)
        if plot.id == "error":
            drawn.add_layout(self._band)
        self._explore(drawn, plot)
        return drawn

    def _explore(self, drawn: figure, plot: PagePlot) -> None:
        """Add the events, and tools for a reader in a pause, in which `page.js` activates them."""
        toolbar = drawn.toolbar
        toolbar.active_drag = toolbar.active_scroll = None
        if plot.across:
            return
        drawn.vspan(
            x="t", source=self._events, line_color="colour", line_dash="dash", line_width="width"
        )
        drawn.add_tools(PanTool(dimensions="width"), WheelZoomTool(dimensions="width"))


def padded(columns: dict[str, Columns]) -> dict[str, NDArray[np.float32]]:
    """Return all curves as columns of one length, padded with NaN."""
    length = max(len(columns[name]["t"]) for name in _CURVES)
    padded = {}
    for name in _CURVES:
        for axis, values in columns[name].items():
            column = padded[f"{name}_{axis}"] = np.full(length, np.nan, np.float32)
            column[: len(values)] = values
    return padded


class LivePage:
    """Page of one viewer, drawn five times a second.

    silent_ns: returns the time in ns since the last message from the display. mark: requests a
    mark with a text, which may be empty.
    """

    def __init__(
        self,
        document: Document,
        live: LiveState,
        silent_ns: Callable[[], int],
        mark: Callable[[str], None],
    ) -> None:
        self._live, self._silent_ns, self._mark = live, silent_ns, mark
        self._plots = Plots()
        self._texts = ColumnDataSource({"shown": [None]})
        self._choices = ColumnDataSource(
            {"paused": [False], "window_s": [WINDOW_S], "contactor": [0], "seen": [0]}
        )
        # Number and text of the reader's last mark.
        self._marked = ColumnDataSource({"number": [0], "text": [""]})
        self._marked.on_change("data", lambda _, __, data: self._mark(str(data["text"][0])))
        update = CustomJS(
            args={
                **{"texts": self._texts, "choices": self._choices, "marked": self._marked},
                **self._plots.sources,
                "plots": {
                    plot.id: {
                        "across": bool(plot.across),
                        "unit": plot.unit,
                        "curves": [curve._asdict() for curve in plot.curves],
                    }
                    for plot in (*PLOTS, FINGERS)
                },
            },
            code=_text("read_out.js") + _text("page.js"),
        )
        document.js_on_event(DocumentReady, update)
        document.js_on_event(ConnectionLost, CustomJS(code=SERVER_LOST))
        # `SERVER_LOST` replaces Bokeh's own notice.
        document.config.update(notify_connection_status=False, reconnect_session=False)
        self._texts.js_on_change("data", update)
        # A source without a plot is sent only if some model refers to it.
        self._plots.roots[0].tags = [self._texts, self._choices, self._marked]
        for root in self._plots.roots:
            document.add_root(root)
        document.title = "telepulse: live"
        document.template = Template(_text("page.html"), trim_blocks=True, lstrip_blocks=True)
        document.template_variables.update(
            css=_text("page.css"),
            windows=WINDOWS_S,
            window=WINDOW_S,
            figures=text.FIGURES,
            plots=PLOTS,
            fingers=FINGERS,
            event_lines=EVENT_LINES.values(),
            columns=text.CONTACTOR_COLUMNS,
        )
        # Data and texts by window and contactor: of all at the beginning of a pause, else of the
        # chosen ones.
        self._shown: dict[tuple[int, int], tuple[WindowData, dict[str, Any]]] = {}
        self._paused = False
        self._drawn: WindowData | None = None
        self._number = 0
        self.draw()
        # Bokeh removes this callback with the viewer's session.
        document.add_periodic_callback(self.draw, REDRAW_MS)

    def draw(self) -> None:
        """Draw the present state; on a paused page only state and alarms.

        A browser that has not drawn the last update gets no further one: on a slow browser updates
        would queue, and it would show the past.
        """
        live, choices = self._live, self._choices.data
        if choices["seen"][0] != self._number:
            return
        self._number += 1
        silent_ns = self._silent_ns()
        (paused,), (number,), (window_s,) = (
            choices[name] for name in ("paused", "contactor", "window_s")
        )
        window_s = window_s if window_s in WINDOWS_S else WINDOW_S
        everyone = range(len(live.contactors))
        number = number if number in everyone else 0
        if not (paused and self._paused and (window_s, number) in self._shown):
            wanted = product(WINDOWS_S, everyone) if paused else [(window_s, number)]
            self._shown = {each: self._window(*each, silent_ns) for each in wanted}
        self._paused = paused
        data, texts = self._shown[window_s, number]
        if data is not self._drawn:
            self._drawn = data
            self._plots.show(data)
        state, note = text.state(live, silent_ns)
        content: dict[str, Any] = {
            "stream": live.stream,
            "state": state,
            "note": note,
            **texts,
            "old": bool(text.age(live, silent_ns)),
            "alarms": text.alarms(live, silent_ns),
            "events": [
                (t_ns // 1_000_000, *rest)
                for t_ns, *rest in list(live.events)[: -LISTED_EVENTS - 1 : -1]
            ],
            "number": self._number,
        }
        self._texts.data = {"shown": [content]}

    def _window(
        self, window_s: int, number: int, silent_ns: int
    ) -> tuple[WindowData, dict[str, Any]]:
        """Return the data of a contactor in a window, and the texts that belong to it."""
        data = window_data(self._live, window_s * SECOND_NS, number)
        return data, {
            "figures": text.figures(self._live, data, silent_ns),
            "contactors": text.contactor_rows(self._live, data),
            "beyond": text.beyond(self._live),
            "chosen": data.chosen,
            "hidden": data.hidden,
            "empty": data.empty,
            "colours": FINGER_COLOURS,
        }


@cache
def _text(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
