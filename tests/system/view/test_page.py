"""The live page in a real browser, fed by real nodes."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from telepulse.processes import free_addresses
from tests.support.browser import CONTRAST, Page, Visit, unfold
from tests.support.nodes import RADIAL, process, start
from tests.support.waiting import PATIENCE_S, until

MODULE = "telepulse"
# Folder for the pictures of the documentation: TELEPULSE_SCREENSHOTS=docs/images
PICTURES = os.environ.get("TELEPULSE_SCREENSHOTS")
# For them the nodes have a priority: the browser draws in software, on the same processors.
REALTIME = ("--realtime", "fifo=40,slack") if PICTURES else ()
CURVES = "Bokeh.documents[0].get_model_by_name('force').renderers[0].data_source.data"
NEWEST = f"[...{CURVES}.finger_y].findLast(Number.isFinite)"
DRAWN = f"JSON.stringify([...{CURVES}.finger_y])"
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
        # Empty while the newest tick is not at full strength.
        await_figure(page, "delay")
        # On a busy machine a tick or two may be limited.
        assert re.fullmatch(r"never|0\.\d s", text_of(page, "at-a-limit"))
        # The scene's 75, unless the loop is held up.
        rate = page.wait_for_function("parseFloat(document.getElementById('heart').textContent)")
        assert 40 < rate.json_value() < 150
        if PICTURES:
            # Until the window holds nothing from before the prediction is trusted.
            page.wait_for_timeout(16_000)
        keep(page, "view.png")


def test_before_the_first_telemetry_alarms_are_unknown_and_not_none(visit: Visit) -> None:
    """Also while the page loads: without its script it shows the same."""
    _, telemetry = free_addresses(2)
    border = "getComputedStyle(document.getElementById('calm')).borderLeftColor"
    with process(MODULE, "view", telemetry) as view:
        url = view.read_line(3 * PATIENCE_S).removeprefix("page: ")
        with visit(url) as page:
            page.locator("#state-note", has_text="no telemetry from a display yet").wait_for()
            assert text_of(page, "calm").startswith("Alarms are unknown")
            unknown = page.evaluate(border)
            options = ("--telemetry", telemetry, "--connect", free_addresses(1)[0], "--quiet")
            with process("display_node.cli", str(RADIAL), *options):
                page.locator("#calm", has_text=re.compile("^No alarm.$")).wait_for()
                assert page.evaluate(border) != unknown
        with visit(url, java_script_enabled=False) as page:
            assert text_of(page, "calm").startswith("Alarms are unknown")


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


def test_lines_and_marks_are_seen_on_both_grounds(page: Page) -> None:
    unfold(page)
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        swatches = page.locator(".keys :is(i, b):visible").all()
        assert len(swatches) > 10
        for swatch in swatches:
            assert swatch.evaluate(CONTRAST) >= 3


def await_figure(page: Page, id: str) -> None:
    page.wait_for_function(f"document.getElementById('{id}').textContent !== '–'")
