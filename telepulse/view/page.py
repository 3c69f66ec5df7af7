"""The page as a Bokeh document, one for each viewer, and its plots.

Colours of axes and grids come from the page's style sheet, light or dark; those of the curves are
legible on both.
"""

from collections.abc import Callable
from copy import deepcopy
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
from bokeh.document import Document
from bokeh.events import ConnectionLost, DocumentReady
from bokeh.models import BasicTicker, ColumnDataSource, CustomJS, PanTool, Range1d, WheelZoomTool
from bokeh.models.annotations import BoxAnnotation
from bokeh.plotting import figure
from jinja2 import Template
from numpy.typing import NDArray

from telepulse.view import text
from telepulse.view.live import LISTED_EVENTS, LiveState
from telepulse.view.plots import EVENT_LINES, FINGER_COLOURS, FINGERS, MUTED, PLOTS, PagePlot
from telepulse.view.window_data import (
    ALL_GROUPS,
    SECOND_NS,
    Columns,
    WindowData,
    hidden_plots,
    window_data,
    window_scores,
)

# Texts change at every second redraw.
REDRAW_MS, TEXTS_EVERY = 200, 2
# A browser may draw in software, on the processors of the display's loop. For each such share of
# missed ticks the page is drawn by one `REDRAW_MS` less often, down to once in so many of them.
MISSED_PER_STEP, SELDOM = 0.001, 5
WINDOWS_S = (5, 10, 30, 60)
WINDOW_S = 10
# Runs in the browser when the connection to the server is lost: the page keeps the last state.
SERVER_LOST = """
const at = (id) => document.getElementById(id), over = ["ended", "fault"];
if (!over.includes(at("state").dataset.state)) {
  at("state").textContent = at("state").dataset.state = "ended";
  at("state-note").textContent = `at ${new Date().toLocaleTimeString("en-GB")}`;
}
at("state-note").textContent += "; the server of this page has ended: it shows the last state";
document.body.dataset.lost = "yes";
for (const each of document.querySelectorAll("button, input")) each.disabled = true;
"""
HEIGHT = 220
EVENT_COLUMNS = "t", "text", "colour", "dash", "width"
# Names of the curves, by the group of their plots.
CURVES = {
    group: [curve.name for plot in PLOTS if plot.group == group for curve in plot.curves]
    for group in ALL_GROUPS
}


class Plots:
    """Plots of one viewer.

    roots: their Bokeh models, each named by its id. curves, events: the data of the curves and of
    the events, by the group of the plots. fingers: that of several fingers.
    """

    def __init__(self) -> None:
        # Sources of its own for each group, so that an update draws no folded plot.
        self.curves = {
            group: ColumnDataSource(
                {f"{name}_{axis}": np.empty(0) for name in names for axis in ("t", "y")}
            )
            for group, names in CURVES.items()
        }
        # One row a contactor; empty for an only one.
        self.fingers = ColumnDataSource({"t": [], "y": [], "colour": []})
        self.events = {
            group: ColumnDataSource({name: list[Any]() for name in EVENT_COLUMNS})
            for group in CURVES
        }
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
        rows = [(time_s, text, *EVENT_LINES[kind][1:]) for time_s, kind, text in data.events]
        events = {name: [row[at] for row in rows] for at, name in enumerate(EVENT_COLUMNS)}
        for group, names in CURVES.items():
            if names[0] not in data.columns:
                continue
            self.curves[group].data = padded({name: data.columns[name] for name in names})
            if rows or self.events[group].data["t"]:
                self.events[group].data = events
        for plot, (low, high) in data.limits.items():
            self._limits[plot].update(start=low, end=high)
        if "depth" in data.limits:
            self._forces.update(start=data.force_n[0], end=data.force_n[1])
        if "error" in data.limits:
            jnd_mn = (data.jnd_n or 0.0) * 1e3
            self._band.update(bottom=-jnd_mn, top=jnd_mn)
        if data.fingers or self.fingers.data["colour"]:
            curves = {axis: [finger[axis] for finger in data.fingers] for axis in ("t", "y")}
            colours = list(FINGER_COLOURS[: len(data.fingers)])
            self.fingers.data = curves | {"colour": colours}

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
            style: dict[str, Any] = {"source": self.curves[plot.group], "line_width": 2}
            style["line_color"] = curve.colour
            if curve.marker:
                drawn.scatter(*columns, marker=curve.marker, size=9, fill_color=None, **style)
            else:
                drawn.line(*columns, line_dash=curve.dash, **style)
        if plot.id == FINGERS.id:
            drawn.multi_line("t", "y", source=self.fingers, line_color="colour", line_width=2)
        if plot.id == "error":
            drawn.add_layout(self._band)
        drawn.toolbar.active_drag = drawn.toolbar.active_scroll = None
        if not plot.across:
            drawn.vspan(
                x="t",
                source=self.events[plot.group],
                line_color="colour",
                line_dash="dash",
                line_width="width",
            )
            # Tools for a reader in a pause, in which `page.js` activates them.
            drawn.add_tools(PanTool(dimensions="width"), WheelZoomTool(dimensions="width"))
        return drawn


def padded(columns: dict[str, Columns]) -> dict[str, NDArray[np.float32]]:
    """Return curves as columns of one length, padded with NaN."""
    length = max(len(each["t"]) for each in columns.values())
    padded = {}
    for name, each in columns.items():
        for axis, values in each.items():
            column = padded[f"{name}_{axis}"] = np.full(length, np.nan, np.float32)
            column[: len(values)] = values
    return padded


class LivePage:
    """Page of one viewer.

    silent_ns: returns the time in ns since the last message from the display. mark: requests a
    mark with a text, which may be empty. local: whether the display is on this computer.
    """

    def __init__(
        self,
        document: Document,
        live: LiveState,
        silent_ns: Callable[[], int],
        mark: Callable[[str], None],
        local: bool = False,
    ) -> None:
        self._live, self._silent_ns, self._mark, self._local = live, silent_ns, mark, local
        self._plots = Plots()
        self._texts = ColumnDataSource({"shown": [None]})
        choices: dict[str, Any] = {"paused": False, "window_s": WINDOW_S, "contactor": 0}
        choices |= {"unfolded": "", "seen": 0}
        self._choices = ColumnDataSource({name: [each] for name, each in choices.items()})
        # Number and text of the reader's last mark.
        self._marked = ColumnDataSource({"number": [0], "text": [""]})
        self._marked.on_change("data", lambda _, __, data: self._mark(str(data["text"][0])))
        update = CustomJS(
            args={
                **{"texts": self._texts, "choices": self._choices, "marked": self._marked},
                **{"curves": self._plots.curves, "colours": FINGER_COLOURS},
                **{"fingers": self._plots.fingers, "events": self._plots.events},
                "plots": {
                    plot.id: {
                        "group": plot.group,
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
            always_seen=text.ALWAYS_SEEN,
            groups=text.GROUPS,
            plots=PLOTS,
            fingers=FINGERS,
            event_lines=EVENT_LINES.values(),
            columns=text.CONTACTOR_COLUMNS,
            calm=text.ALARMS_UNKNOWN,
        )
        # State at the beginning of a pause.
        self._frozen: LiveState | None = None
        # Choices of the reader, texts that the browser has, and instant and choices of its plots.
        self._choice: tuple[Any, ...] = ()
        self._sent: dict[str, Any] = {}
        self._drawn: tuple[Any, ...] = ()
        self._redraws = self._undrawn = self._number = self._skipped = 0
        self.draw()
        # Bokeh removes this callback with the viewer's session.
        document.add_periodic_callback(self.draw, REDRAW_MS)

    def draw(self) -> None:
        """Send what has changed since the last update; on a paused page only state and alarms.

        A browser that has not written the last texts gets nothing further: on a slow browser
        updates would queue, and it would show the past.
        """
        if self._choices.data["seen"][0] != self._number:
            return
        choice = paused, window_ns, number, groups = self._chosen()
        chosen, self._choice = choice != self._choice, choice
        self._skipped += 1
        if self._skipped < redraw_every(self._live, self._local) and not chosen:
            return
        self._skipped = 0
        self._redraws += 1
        if not paused:
            self._frozen = None
        elif self._frozen is None:
            self._frozen = deepcopy(self._live)
        live = self._frozen or self._live
        content: dict[str, Any] = {}
        if due := chosen or self._redraws % TEXTS_EVERY == 0:
            content |= self._state()
        if chosen or (due and not paused):
            silent_ns = 0 if paused else self._silent_ns()
            scores = window_scores(live, window_ns, number)
            content |= {
                "figures": [text.figures(live, scores, silent_ns), hidden_plots(live)],
                "contactors": [scores.chosen, text.contactor_rows(live, scores, silent_ns)],
                "beyond": text.beyond(live),
            }
        drawn = live.now_ns, len(live.events), live.display_ended, *choice
        if drawn != self._drawn:
            self._drawn = drawn
            # The last state can be read when the server has ended, in the folded groups as well.
            groups = ALL_GROUPS if live.display_ended else groups
            data = window_data(live, window_ns, number, groups)
            self._plots.show(data)
            self._undrawn += 1
            content |= {"empty": data.empty}
        changed = {name: each for name, each in content.items() if self._sent.get(name) != each}
        # Redraws are acknowledged with the texts, so also where no text has changed.
        if changed or (due and self._undrawn):
            self._sent |= changed
            self._undrawn = 0
            self._number += 1
            self._texts.data = {"shown": [changed | {"number": self._number}]}

    def _chosen(self) -> tuple[bool, int, int, frozenset[str]]:
        """Return whether the page is paused, its window in ns, contactor and unfolded groups."""
        paused, window_s, number, unfolded = (
            self._choices.data[name][0] for name in ("paused", "window_s", "contactor", "unfolded")
        )
        return (
            bool(paused),
            (window_s if window_s in WINDOWS_S else WINDOW_S) * SECOND_NS,
            number if number in range(len(self._live.contactors)) else 0,
            # The plots of no group are always seen.
            ALL_GROUPS & {"", *str(unfolded).split()},
        )

    def _state(self) -> dict[str, Any]:
        """Return the texts that a pause does not stop."""
        live, silent_ns = self._live, self._silent_ns()
        state, note = text.state(live, silent_ns)
        return {
            "stream": live.stream,
            "state": [state, note, live.now_ns // 1_000_000 if live.display_ended else 0],
            "old": bool(text.age(live, silent_ns)),
            # An alarm that lasts keeps its element, whatever its texts.
            "alarms": [
                (str(each.identity), each.name, each.text) for each in text.alarms(live, silent_ns)
            ],
            "calm": text.calm(live),
            "events": [
                (t_ns // 1_000_000, *rest)
                for t_ns, *rest in list(live.events)[: -LISTED_EVENTS - 1 : -1]
            ],
        }


def redraw_every(live: LiveState, local: bool) -> int:
    """Return in how many periods of `REDRAW_MS` a page is drawn once.

    A page on the display's computer yields to a loop that misses ticks while a pulse is felt.
    Before the first status it is drawn in every period, as each state but playing.
    """
    missed = live.summary.get("loop", {}).get("last_5s", {}).get("missed", 0.0)
    if not local or live.display_ended or live.state != "playing":
        return 1
    return min(SELDOM, 1 + int(missed / MISSED_PER_STEP))


@cache
def _text(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")
