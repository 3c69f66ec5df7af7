"""The live page in a real browser, fed by real nodes."""

import os
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from display_node.verdict import NOT_VALID_STATUS
from telepulse.processes import free_addresses
from telepulse.view.plots import EVENT_LINES, MARK
from tests.support.browser import CONTRAST, Page, Visit, unfold
from tests.support.nodes import RADIAL, start
from tests.support.waiting import PATIENCE_S, until

MODULE = "telepulse"
# Folder for the pictures of the documentation: TELEPULSE_SCREENSHOTS=docs/images
PICTURES = os.environ.get("TELEPULSE_SCREENSHOTS")
# For them the nodes have a priority: the browser draws in software, on the same processors.
REALTIME = ("--realtime", "fifo=40,slack") if PICTURES else ()
CURVES = "Bokeh.documents[0].get_model_by_name('force').renderers[0].data_source.data"
NEWEST = f"[...{CURVES}.finger_y].findLast(Number.isFinite)"
DRAWN = f"JSON.stringify([...{CURVES}.finger_y])"
COLOUR_OF_STATE = "getComputedStyle(document.getElementById('state')).color"
SPAN = "-Bokeh.documents[0].get_model_by_name('force').x_range.start"


class Bench:
    """Both nodes, a link between them and the page, each a process that can be ended."""

    def __init__(self) -> None:
        self._sensing, self._display, self._telemetry = free_addresses(3)
        self._running: dict[str, Any] = {}
        view = self._run("view", MODULE, "view", self._telemetry)
        self.url = view.read_line(3 * PATIENCE_S).removeprefix("page: ")
        arguments = (str(RADIAL), "--bind", self._sensing, "--quiet", *REALTIME)
        self._run("sensing", "sensing_node.cli", *arguments)
        self.join()
        self.play()

    def _run(self, name: str, module: str, *arguments: str) -> Any:
        self._running[name] = start(module, *arguments)
        return self._running[name]

    def join(self) -> None:
        self._run("link", MODULE, "link", "--connect", self._sensing, "--bind", self._display)

    def play(self) -> None:
        arguments = ("--connect", self._display, "--telemetry", self._telemetry, "--quiet")
        self._run("display", "display_node.cli", str(RADIAL), *arguments, *REALTIME)

    @contextmanager
    def still(self, name: str) -> Iterator[None]:
        """Stop a process for the time of the `with`."""
        self._running[name].send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._running[name].send_signal(signal.SIGCONT)

    def end(self, name: str) -> tuple[str, str]:
        child = self._running.pop(name)
        child.kill() if name == "link" else child.terminate()
        output: tuple[str, str] = child.communicate(timeout=20)
        return output

    def close(self) -> None:
        errors = {name: self.end(name)[1] for name in list(self._running)}
        assert "Traceback" not in errors["view"]


@pytest.fixture(scope="module")
def bench(browser: object) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


def await_state(page: Page, state: str) -> None:
    page.locator("#state", has_text=re.compile(f"^{state}$")).wait_for()


@pytest.fixture
def page(bench: Bench, visit: Visit) -> Iterator[Page]:
    """The page of a display that plays."""
    with visit(bench.url) as page:
        await_state(page, "playing")
        yield page


def keep(page: Page, name: str) -> None:
    if PICTURES:
        page.evaluate("scrollTo(0, 0)")
        page.screenshot(path=Path(PICTURES) / name)


def test_the_page_moves_and_shows_what_is_felt(bench: Bench, visit: Visit) -> None:
    with visit(bench.url, viewport={"width": 1280, "height": 1000}) as page:
        await_state(page, "playing")
        assert page.title() == "telepulse: live"
        assert page.locator("html").get_attribute("lang") == "en"
        await_figure(page, "in_phase")
        await_figure(page, "heart")
        await_figure(page, "force")
        plot = page.locator("#plot-force")
        before, newest, ticks = plot.screenshot(), page.evaluate(NEWEST), text_of(page, "loop-note")
        page.wait_for_function(f"{NEWEST} !== {newest}")
        page.wait_for_function(f"document.getElementById('loop-note').textContent !== '{ticks}'")
        until(lambda: plot.screenshot() != before)
        assert text_of(page, "stream") == "radial pulse"
        assert text_of(page, "predictor") == "stack"
        # Empty while the newest tick is not scored.
        await_figure(page, "delay")
        # On a busy machine a tick or two may be limited.
        assert re.fullmatch(r"never|0\.\d s", text_of(page, "at-a-limit"))
        # The scene's 75, unless the loop is held up.
        rate = page.wait_for_function("parseFloat(document.getElementById('heart').textContent)")
        assert 40 < rate.json_value() < 150
        if PICTURES:
            page.wait_for_timeout(10_000)
        keep(page, "view.png")


def text_of(page: Page, id: str) -> str:
    # Also of a folded group.
    text: str = page.locator(f"#{id}").text_content()
    return text.replace("\xa0", " ")


def stands_still(page: Page, ms: int) -> bool:
    before = page.evaluate(DRAWN)
    page.wait_for_timeout(ms)
    return bool(page.evaluate(DRAWN) == before)


def test_a_cut_link_is_an_alarm_that_goes_again(bench: Bench, page: Page) -> None:
    assert page.locator("#alarms").get_attribute("aria-live") == "assertive"
    bench.end("link")
    page.locator("#alarms", has_text="link cut").wait_for()
    await_state(page, "stale")
    page.wait_for_function("document.getElementById('heart').textContent === '–'")
    bench.join()
    await_state(page, "playing")
    page.locator("#alarms li[data-name='link cut']").wait_for(state="detached")
    assert page.locator("#events", has_text="state: playing").is_visible()


def test_a_display_that_stands_still_is_grey_and_has_its_age(bench: Bench, page: Page) -> None:
    page.locator("body:not(.old)").wait_for()
    bright = page.evaluate(COLOUR_OF_STATE)
    with bench.still("display"):
        page.locator("body.old").wait_for()
        assert re.fullmatch(r"\d+\.\d s ago", text_of(page, "state-note"))
        assert page.evaluate(COLOUR_OF_STATE) != bright
        assert text_of(page, "heart") == "–"
    page.locator("body:not(.old)").wait_for()
    await_state(page, "playing")


FOLDED = "Bokeh.documents[0].get_model_by_name('delay').renderers[0].data_source.data.one_way_y"


def test_the_key_m_and_a_text_mark_the_time(page: Page) -> None:
    page.keyboard.press("m")
    page.locator("#events", has_text=re.compile("mark: mark \\d")).wait_for()
    page.locator("#mark-text").click()
    page.keyboard.type("mm, tom")
    assert page.locator("#mark-text").input_value() == "mm, tom"
    page.keyboard.press("Enter")
    page.locator("#events", has_text="mark: mm, tom").wait_for()
    assert page.locator("#mark-text").input_value() == ""
    # Letters of the text are no keys.
    assert page.locator("#events li", has_text="mark: ").count() == 2
    events = "Bokeh.documents[0].get_model_by_name('force').renderers.at(-1).data_source.data"
    page.wait_for_function(f"[...{events}.text].some((text) => text.includes('mm, tom'))")
    colour = page.evaluate(f"[...{events}.colour][[...{events}.text].indexOf('mark: mm, tom')]")
    assert colour == EVENT_LINES[MARK].colour


def test_a_pause_is_explored_and_resumed(page: Page) -> None:
    page.wait_for_function(f"{SPAN} === 10")
    page.locator("#pause").click()
    assert page.locator("#pause").inner_text() == "Resume"
    until(lambda: stands_still(page, 500))
    plot = page.locator("#plot-force .drawn")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.wheel(0, -300)
    page.wait_for_function(f"{SPAN} < 9")
    # Values of the present zoom, at once and after the pointer has moved.
    values = page.locator("#plot-force .read-out li")
    values.filter(has_text=re.compile(r"at the (wrist|finger) −?[\d.]+\smN")).first.wait_for()
    text = values.first.inner_text()
    page.mouse.move(box["x"] + box["width"] * 0.7, box["y"] + box["height"] / 2)
    until(lambda: values.first.inner_text() != text)
    # Another window of the same moment.
    newest = page.evaluate(NEWEST)
    page.locator("input[name=window][value='5']").check(force=True)
    page.wait_for_function(f"{SPAN} === 5")
    assert page.evaluate(NEWEST) == newest
    until(lambda: stands_still(page, 1_000))
    page.locator("#pause").click()
    assert page.locator("#pause").inner_text() == "Pause"
    page.wait_for_function(f"{NEWEST} !== {newest}")
    page.locator("input[name=window][value='10']").check(force=True)
    page.wait_for_function(f"{SPAN} === 10")


def test_a_phone_shows_it_without_scrolling_sideways(bench: Bench, visit: Visit) -> None:
    with visit(bench.url, viewport={"width": 390, "height": 800}, has_touch=True) as page:
        await_state(page, "playing")
        unfold(page)
        for width in (320, 390):
            page.set_viewport_size({"width": width, "height": 800})
            # Plots are drawn anew after the window has its width.
            page.wait_for_function(f"document.documentElement.scrollWidth <= {width}")
            boxes = [plot.bounding_box() for plot in page.locator("figure:visible").all()]
            assert len(boxes) == 7
            tiles = page.locator(".now .figures > div").all()
            boxes += [tile.bounding_box() for tile in tiles]
            assert len(boxes) == 7 + 4
            assert all(box["x"] >= 0 and box["x"] + box["width"] <= width for box in boxes)


ROWS = "[...document.getElementById('contactors').rows].map(row => row.cells[0].textContent)"
CHOSEN = "document.querySelector('#contactors [aria-current=true]').cells[0].textContent"
FINGERS = "Bokeh.documents[0].get_model_by_name('fingers').renderers[0].data_source.data"


def test_three_fingers_are_shown_and_one_is_chosen_by_keyboard_also_in_a_pause(
    visit: Visit,
) -> None:
    link = "delay=40ms,jitter=10ms,loss=1%"
    demo = start(
        *(MODULE, "demo", "three_fingers", "--link", link, "--seconds", "100"),
        *("--no-ui", "--page"),
    )
    try:
        url = demo.read_line(3 * PATIENCE_S).removeprefix("page: ")
        with visit(url) as page:
            await_state(page, "playing")
            page.wait_for_function(f"{ROWS}.length === 3")
            assert page.evaluate(ROWS) == ["cun", "guan", "chi"]
            assert page.locator("#fingers-keys").inner_text().split() == ["cun", "guan", "chi"]
            page.wait_for_function(f"{FINGERS}.y.length === 3")
            assert page.locator("#plot-fingers").bounding_box()["height"] > 200
            assert page.locator("#plot-force h3").inner_text() == "Force – cun"
            await_figure(page, "aligned")
            for scheme in ("light", "dark"):
                page.emulate_media(color_scheme=scheme)
                for selector in (
                    *("#contactor input:checked + span", "#contactor input:not(:checked) + span"),
                    *(".contactors th", ".contactors td", "#fingers-keys"),
                ):
                    assert page.locator(selector).first.evaluate(CONTRAST) > 4.5
            # Pause, window, contactor.
            for _ in range(3):
                page.keyboard.press("Tab")
            assert page.evaluate("document.activeElement.name") == "contactor"
            page.keyboard.press("ArrowRight")
            label = "document.activeElement.nextElementSibling"
            assert page.evaluate(f"{label}.textContent") == "guan"
            assert page.evaluate(f"getComputedStyle({label}).outlineStyle") == "solid"
            page.wait_for_function(f"{CHOSEN} === 'guan'")
            assert page.locator("#plot-force h3").inner_text() == "Force – guan"
            assert text_of(page, "aligned-note").startswith("guan: RMS of the last 10 s")
            page.locator("#pause").click()
            # The last update comes after the pause, on a busy machine by more than its interval.
            until(lambda: stands_still(page, 1_500))
            table = page.locator(".contactors table").inner_text()
            drawn = page.evaluate(DRAWN)
            page.locator("#contactor input:checked").focus()
            page.keyboard.press("ArrowRight")
            page.wait_for_function(f"{CHOSEN} === 'chi'")
            until(lambda: page.evaluate(DRAWN) != drawn)
            assert stands_still(page, 1_500)
            assert page.locator("#plot-error .of").text_content() == " – chi"
            # The data of the pause: that of the others, and the same after a choice and back.
            assert page.locator(".contactors table").inner_text() == table
            page.keyboard.press("ArrowLeft")
            page.wait_for_function(f"{CHOSEN} === 'guan'")
            until(lambda: page.evaluate(DRAWN) == drawn)
    finally:
        # A killed demo would leave its page's server behind.
        demo.send_signal(signal.SIGINT)
        _, errors = demo.communicate(timeout=40)
    # On a busy machine, the run of three fingers in software may not be valid.
    assert demo.returncode in (0, NOT_VALID_STATUS), errors


def await_figure(page: Page, id: str) -> None:
    page.wait_for_function(f"document.getElementById('{id}').textContent !== '–'")


def test_the_last_state_stays_when_the_demo_has_ended(visit: Visit) -> None:
    demo = start(MODULE, "demo", "--seconds", "100", "--no-ui", "--page")
    try:
        url = demo.read_line(3 * PATIENCE_S).removeprefix("page: ")
        with visit(url) as page:
            await_state(page, "playing")
            demo.send_signal(signal.SIGINT)
            output, errors = demo.communicate(timeout=40)
            assert demo.returncode == 0, errors
            assert "The pulse was felt for" in output
            await_state(page, "ended")
            page.locator("#state-note", has_text="the server of this page has ended").wait_for()
            assert re.match(r"at \d\d:\d\d:\d\d; ", text_of(page, "state-note"))
            assert page.locator("#pause").is_disabled()
            # All of it can still be read.
            assert page.evaluate(NEWEST) is not None
            unfold(page)
            assert page.evaluate(f"[...{FOLDED}].some(Number.isFinite)")
    finally:
        demo.kill()
        demo.communicate()
