"""The plots of the live page in a real browser: values under the pointer, events, touch, colours.

The displays are simulated and stand still, so that every position shows the same in each run.
"""

import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from bokeh.document import Document
from bokeh.server.server import Server
from matplotlib.image import imread
from tornado.ioloop import IOLoop

from display_node.press.sweep import SweepPlan
from telepulse.view.live import LiveState
from telepulse.view.page import LivePage
from telepulse.view.plots import EVENT_LINES, FINGERS, MARK, PLOTS
from tests.support.browser import CONTRAST, Page, Visit, unfold
from tests.support.page_states import SimulatedDisplay, play_sweep
from tests.support.recorded_sweeps import SweptWrist

LONG = "a very long text of a mark that somebody typed to see what a small screen shows of it"
TOUCH: dict[str, Any] = {
    "viewport": {"width": 390, "height": 800},
    "has_touch": True,
    "is_mobile": True,
}
SHOWN = """[...document.querySelectorAll("figure")].filter(
  (figure) => figure.offsetParent && !figure.querySelector(".empty:not([hidden])")
).map((figure) => figure.id.replace("plot-", ""))"""
SPAN = "Bokeh.documents[0].get_model_by_name('force').x_range"
# Position of a time in the plot of the force, in the window.
PLACE = """(time) => {
  const { frame } = Bokeh.index.get_one(Bokeh.documents[0].get_model_by_name("force"));
  const { left, top } = document.querySelector("#plot-force .drawn").getBoundingClientRect();
  return [left + frame.x_scale.compute(time), top + (frame.bbox.top + frame.bbox.bottom) / 2];
}"""
SIGNED = r"−?[\d.]+(e−?\d+)?"


def one_finger() -> LiveState:
    """Return the state of a display in whose last 10 s were events of every kind."""
    display = SimulatedDisplay(LiveState())
    display.go(12)
    display.event("limited", "slew limit reached", "WARNING")
    display.go(2)
    display.event("fault", "feedback lost", "ERROR")
    display.event("mark", "cuff on")
    display.go(2)
    display.event("mark", LONG)
    display.go(2)
    return display.live


def three_fingers() -> LiveState:
    display = SimulatedDisplay(LiveState(), names=("cun", "guan", "chi"))
    display.go(12)
    return display.live


def pressed() -> LiveState:
    display = SimulatedDisplay(LiveState())
    play_sweep(display, SweptWrist(SweepPlan(low_n=0.4, high_n=2.0, steps=6, beats=3)), 1.2)
    return display.live


STATES = (one_finger, three_fingers, pressed)


@pytest.fixture(scope="module")
def url(browser: object) -> Iterator[str]:
    """Serve a page of each state, by the name of its function."""
    states = {state.__name__: state() for state in STATES}
    started, servers = Event(), list[Server]()

    def open_page(live: LiveState, document: Document) -> None:
        LivePage(document, live, lambda: 0, lambda _: None)

    def serve() -> None:
        loop = IOLoop(make_current=True)
        pages = {f"/{name}": partial(open_page, live) for name, live in states.items()}
        origins = ["*"]
        servers.append(
            Server(pages, io_loop=loop, port=0, address="127.0.0.1", allow_websocket_origin=origins)
        )
        servers[0].start()
        loop.add_callback(started.set)
        loop.start()
        loop.close()

    thread = Thread(target=serve)
    thread.start()
    assert started.wait(30)
    [server] = servers
    yield f"http://127.0.0.1:{server.port}"
    server.io_loop.add_callback(server.stop)
    server.io_loop.add_callback(server.io_loop.stop)
    thread.join(30)


@contextmanager
def still(visit: Visit, address: str, **reader: Any) -> Iterator[Page]:
    """Open a page and pause it."""
    with visit(address, **reader) as page:
        page.locator("body[data-ready]").wait_for()
        page.locator("#state", has_text="playing").wait_for()
        unfold(page)
        page.locator("#pause").click()
        page.wait_for_function("!document.getElementById('explore').hidden")
        yield page


def rows_at(page: Page, id: str, x: float, y: float, touch: bool = False) -> list[str]:
    """Return the rows that a plot shows under a pointer at a point of the window."""
    shown = page.locator(f"#plot-{id} .read-out")
    if touch:
        page.touchscreen.tap(x, y)
    else:
        # From outside, so that the rows are those of this point.
        page.mouse.move(1, 1)
        shown.wait_for(state="hidden")
        page.mouse.move(x, y)
    shown.wait_for()
    return [text.replace("\xa0", " ") for text in shown.locator("li").all_inner_texts()]


def in_sight(page: Page, id: str) -> dict[str, float]:
    """Scroll a plot to where a pointer meets it, and return its box."""
    drawn = page.locator(f"#plot-{id} .drawn")
    drawn.evaluate("(it) => it.scrollIntoView({ block: 'center', behavior: 'instant' })")
    box: dict[str, float] = drawn.bounding_box()
    return box


@pytest.mark.parametrize("state", ["three_fingers", "pressed"])
def test_each_plot_shows_the_values_of_all_its_curves_anywhere(
    url: str, visit: Visit, state: str
) -> None:
    plots = {plot.id: plot for plot in (*PLOTS, FINGERS)}
    with still(visit, f"{url}/{state}") as page:
        ids = page.evaluate(SHOWN)
        assert len(ids) >= 5
        for id in ids:
            box, plot = in_sight(page, id), plots[id]
            # Curves with values; one without words is the upper limit of the one before.
            known = [
                curve.words.split(":")[0]
                for curve in plot.curves
                if curve.words and page.evaluate(HAS_VALUES, [id, f"{curve.name}_y"])
            ]
            if id == FINGERS.id:
                known = ["cun", "guan", "chi"]
            with_values = dict.fromkeys(known, 0)
            for share, depth in ((0.2, 0.3), (0.4, 0.5), (0.6, 0.1), (0.8, 0.7)):
                x, y = box["x"] + share * box["width"], box["y"] + depth * box["height"]
                place, *rows = rows_at(page, id, x, y)
                assert re.fullmatch(rf"at {SIGNED} {'N' if plot.across else 's'}", place)
                assert [row for name in known for row in rows if row.startswith(f"{name} ")]
                for name, row in zip(known, rows, strict=False):
                    unit = re.escape(plot.unit)
                    value = re.match(rf"{name} ({SIGNED} ({unit}|N)|–)( to |, at |$)", row)
                    assert value, (id, row)
                    with_values[name] += value[1] != "–"
            # A curve may end within the window, or lie at one hold-down.
            assert all(count >= 2 for count in with_values.values()), (id, with_values)


HAS_VALUES = """([id, name]) => {
  const { data } = Bokeh.documents[0].get_model_by_name(id).renderers[0].data_source;
  return [...data[name]].some(Number.isFinite);
}"""
NEAREST = """([name, time]) => {
  const { data } = Bokeh.documents[0].get_model_by_name("force").renderers[0].data_source;
  const gaps = [...data[`${name}_t`]].map((t) => Number.isFinite(t) ? Math.abs(t - time) : 1e9);
  return data[`${name}_y`][gaps.indexOf(Math.min(...gaps))];
}"""


def test_the_values_are_those_of_the_data_at_that_time(url: str, visit: Visit) -> None:
    with still(visit, f"{url}/one_finger") as page:
        in_sight(page, "force")
        for time_s in (-8.1234, -5.05, -0.7):
            place, *rows = rows_at(page, "force", *page.evaluate(PLACE, time_s))
            shown_s = float(place.split()[1].replace("−", "-"))
            assert shown_s == pytest.approx(time_s, abs=0.02)
            for row, name in zip(rows[:2], ("wrist", "finger"), strict=True):
                value = float(row.split()[-2])
                # A pulse of 300 mN changes by 12 mN in 5 ms, the step of the shown time.
                assert value == pytest.approx(page.evaluate(NEAREST, [name, shown_s]), abs=15)


def test_events_have_lines_a_key_and_their_texts_at_the_pointer(url: str, visit: Visit) -> None:
    with still(visit, f"{url}/one_finger") as page:
        keys = page.locator("#event-keys span").all_inner_texts()
        assert [key.strip() for key in keys] == ["information", "warning", "error", "mark"]
        in_sight(page, "force")
        rows = rows_at(page, "force", *page.evaluate(PLACE, -4.0))
        # Two events at one time are two rows.
        assert rows[-2:] == ["fault: feedback lost", "mark: cuff on"]
        rows = rows_at(page, "force", *page.evaluate(PLACE, -6.0))
        assert rows[-1] == "limited: slew limit reached"
        assert not any("mark" in row for row in rows_at(page, "force", *page.evaluate(PLACE, -5)))
        page.mouse.move(1, 1)
        page.locator("#plot-force .read-out").wait_for(state="hidden")
        for time_s, kind in ((-6.0, "warning"), (-2.0, MARK)):
            x, _ = page.evaluate(PLACE, time_s)
            assert is_drawn(page, EVENT_LINES[kind].colour, x), kind
        listed = page.locator("#events li.mark").all_inner_texts()
        assert [re.sub(r"^[\d:\s]+", "", text) for text in listed] == [
            f"mark: {LONG}",
            "mark: cuff on",
        ]


def is_drawn(page: Page, colour: str, x: float) -> bool:
    """Return whether a vertical line of a colour is within 3 pixels of a place in the plot."""
    box = in_sight(page, "force")
    pixels = imread(io.BytesIO(page.screenshot()))[..., :3]
    near = pixels[int(box["y"]) : int(box["y"] + box["height"]), round(x) - 3 : round(x) + 4]
    wanted = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)]) / 255
    same = (np.abs(near - wanted) < 0.05).all(axis=2)
    return int(same.any(axis=1).sum()) > 40


def drag(page: Page, x: float, y: float, across: float, down: float) -> None:
    """Move a finger over the page."""
    session = page.context.new_cdp_session(page)

    def send(kind: str, points: list[dict[str, float]]) -> None:
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    send("touchStart", [{"x": x, "y": y}])
    for step in range(1, 16):
        send("touchMove", [{"x": x + across * step / 15, "y": y + down * step / 15}])
    send("touchEnd", [])


def test_a_finger_scrolls_moves_and_taps_a_paused_plot(url: str, visit: Visit) -> None:
    with still(visit, f"{url}/one_finger", **TOUCH) as page:
        hint = page.locator("#explore").inner_text()
        assert "pinch" in hint
        assert "tap" in hint
        box = in_sight(page, "force")
        x, y = box["x"] + 0.6 * box["width"], box["y"] + 0.5 * box["height"]
        before = page.evaluate("scrollY")
        drag(page, x, y, 0, -200)
        page.wait_for_function(f"scrollY > {before} + 100")
        assert page.evaluate(f"{SPAN}.end") == 0
        in_sight(page, "force")
        drag(page, x, y, 120, 0)
        page.wait_for_function(f"{SPAN}.end < -1")
        # A browser takes a tap at once after a drag for a part of it.
        page.wait_for_timeout(600)
        page.locator("label", has_text="10 s").tap()
        page.wait_for_function(f"{SPAN}.end === 0")
        in_sight(page, "force")
        place, *rows = rows_at(page, "force", *page.evaluate(PLACE, -2.0), touch=True)
        assert place.startswith("at −")
        assert rows[-1] == f"mark: {LONG}"
        # It stays after the finger has left, within the plot.
        page.wait_for_timeout(300)
        shown = page.locator("#plot-force .read-out").bounding_box()
        box = in_sight(page, "force")
        assert shown["x"] >= box["x"]
        assert shown["x"] + shown["width"] <= box["x"] + box["width"]


def test_lines_and_marks_are_seen_on_both_grounds(url: str, visit: Visit) -> None:
    with visit(f"{url}/pressed") as page:
        page.locator("#state", has_text="playing").wait_for()
        page.locator("#plot-force .keys i").first.wait_for()
        unfold(page)
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            swatches = page.locator(".keys :is(i, b):visible").all()
            assert len(swatches) > 15
            for swatch in swatches:
                assert swatch.evaluate(CONTRAST) >= 3
