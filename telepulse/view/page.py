"""The page as a Bokeh document, one for each viewer."""

from collections.abc import Callable
from functools import cache
from importlib.resources import files
from typing import Any

from bokeh.document import Document
from bokeh.events import ConnectionLost, DocumentReady
from bokeh.models import ColumnDataSource, CustomJS
from jinja2 import Template

from telepulse.view import text
from telepulse.view.live import LiveState
from telepulse.view.picture import picture
from telepulse.view.plots import PLOTS, Plots
from telepulse.view.text import alarms

REDRAW_MS = 200
WINDOWS_S = (5, 10, 30, 60)
WINDOW_S = 10
SECOND_NS = 1_000_000_000
# Runs in the browser when the connection to the server is lost: the last state stays.
SERVER_LOST = """
document.getElementById("state").textContent = "ended";
document.getElementById("state").dataset.state = "ended";
document.getElementById("state-note").textContent =
  "the server of this page has ended: it shows the last state";
"""


class LivePage:
    """Page of one viewer, drawn five times a second.

    silent_ns: returns for how long nothing came from the display.
    """

    def __init__(self, document: Document, live: LiveState, silent_ns: Callable[[], int]) -> None:
        self._live, self._silent_ns = live, silent_ns
        self._plots = Plots()
        self._texts = ColumnDataSource({"shown": [None]})
        self._choices = ColumnDataSource({"paused": [False], "window_s": [WINDOW_S], "seen": [0]})
        update = CustomJS(
            args={"texts": self._texts, "choices": self._choices}, code=_text("page.js")
        )
        document.js_on_event(DocumentReady, update)
        document.js_on_event(ConnectionLost, CustomJS(code=SERVER_LOST))
        # `SERVER_LOST` replaces Bokeh's own notice.
        document.config.update(notify_connection_status=False, reconnect_session=False)
        self._texts.js_on_change("data", update)
        # Sources without a plot need a model that refers to them.
        self._plots.roots[0].tags = [self._texts, self._choices]
        for root in self._plots.roots:
            document.add_root(root)
        document.title = "telepulse: live"
        document.template = _template()
        document.template_variables.update(
            css=_text("page.css"),
            windows=WINDOWS_S,
            window=WINDOW_S,
            figures=text.FIGURES,
            plots=PLOTS,
        )
        self._figures: dict[str, text.PageFigure] = {}
        self._number = 0
        self.draw()
        # Bokeh ends it with the viewer's session.
        document.add_periodic_callback(self.draw, REDRAW_MS)

    def draw(self) -> None:
        """Draw the present state; on a paused page only state and alarms.

        A browser that has not shown the last picture gets no other. On a slow one pictures would
        queue, and it would show the past.
        """
        live, choices = self._live, self._choices.data
        if choices["seen"][0] != self._number:
            return
        self._number += 1
        silent_ns = self._silent_ns()
        if not choices["paused"][0]:
            (choice,) = choices["window_s"]
            window_s = choice if choice in WINDOWS_S else WINDOW_S
            shown = picture(live, window_s * SECOND_NS)
            self._plots.show(shown, window_s)
            self._figures = text.figures(live, shown, silent_ns)
        state, note = text.state(live, silent_ns)
        content: dict[str, Any] = {
            "stream": live.stream,
            "state": state,
            "note": note,
            "figures": self._figures,
            "old": bool(text.age(live, silent_ns)),
            "alarms": alarms(live, silent_ns),
            "events": [(t_ns // 1_000_000, *rest) for t_ns, *rest in reversed(live.events)],
            "number": self._number,
        }
        self._texts.data = {"shown": [content]}


@cache
def _text(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


@cache
def _template() -> Template:
    template: Template = Template(_text("page.html"), trim_blocks=True, lstrip_blocks=True)
    return template
