"""The page as a Bokeh document, one for each viewer."""

from collections.abc import Callable
from functools import cache
from importlib.resources import files
from typing import Any

from bokeh.document import Document
from bokeh.events import ConnectionLost, DocumentReady
from bokeh.models import ColumnDataSource, CustomJS
from jinja2 import Template

from telepulse.view import text as words
from telepulse.view.live import LiveState
from telepulse.view.picture import picture
from telepulse.view.plots import PLOTS, Plots
from telepulse.view.text import alarms

REDRAW_MS = 200
WINDOWS_S = (5, 10, 30, 60)
WINDOW_S = 10
SECOND_NS = 1_000_000_000


class LivePage:
    """One viewer's page: draws what is known of the display, five times a second.

    silent_ns: tells for how long nothing came from the display.
    """

    def __init__(self, document: Document, live: LiveState, silent_ns: Callable[[], int]) -> None:
        self._live, self._silent_ns = live, silent_ns
        self._plots = Plots()
        self._words = ColumnDataSource({"said": [None]})
        self._wishes = ColumnDataSource({"paused": [False], "window_s": [WINDOW_S], "seen": [0]})
        say = CustomJS(args={"words": self._words, "wishes": self._wishes}, code=_text("page.js"))
        gone = CustomJS(code=_text("gone.js"))
        document.js_on_event(DocumentReady, say)
        document.js_on_event(ConnectionLost, gone)
        # A server that has gone takes its sessions with it; the page says so itself.
        document.config.update(notify_connection_status=False, reconnect_session=False)
        self._words.js_on_change("data", say)
        # What no plot draws is in the document by this.
        self._plots.roots[0].tags = [self._words, self._wishes]
        for root in self._plots.roots:
            document.add_root(root)
        document.title = "telepulse: live"
        document.template = _template()
        document.template_variables.update(
            css=_text("page.css"),
            windows=WINDOWS_S,
            window=WINDOW_S,
            figures=words.FIGURES,
            plots=PLOTS,
        )
        self._figures: dict[str, words.PageFigure] = {}
        self._number = 0
        self.draw()
        # Bokeh ends it with the viewer's session.
        document.add_periodic_callback(self.draw, REDRAW_MS)

    def draw(self) -> None:
        """Bring the page to what is known now; a paused one its state and alarms alone.

        A browser that has not shown the last picture gets no other: on a slow one pictures would
        queue, and it would show what is long over.
        """
        live, wishes = self._live, self._wishes.data
        if wishes["seen"][0] != self._number:
            return
        self._number += 1
        silent_ns = self._silent_ns()
        if not wishes["paused"][0]:
            (wish,) = wishes["window_s"]
            window_s = wish if wish in WINDOWS_S else WINDOW_S
            shown = picture(live, window_s * SECOND_NS)
            self._plots.show(shown, window_s)
            self._figures = words.figures(live, shown, silent_ns)
        state, note = words.state(live, silent_ns)
        said: dict[str, Any] = {
            "stream": live.stream,
            "state": state,
            "note": note,
            "figures": self._figures,
            "old": bool(words.age(live, silent_ns)),
            "alarms": alarms(live, silent_ns),
            "events": [(t_ns // 1_000_000, *rest) for t_ns, *rest in reversed(live.events)],
            "number": self._number,
        }
        self._words.data = {"said": [said]}


@cache
def _text(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


@cache
def _template() -> Template:
    template: Template = Template(_text("page.html"), trim_blocks=True, lstrip_blocks=True)
    return template
