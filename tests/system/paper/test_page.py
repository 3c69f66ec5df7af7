"""The page of a report in a real browser: folded chapters, tables and plots, wide and narrow."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from protocol.provenance import Provenance
from telepulse.document import Chapter, Plot, Report, Table, check_can_report, write_report
from tests.support.browser import Page, Visit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PHONE = {"width": 390, "height": 800}
DESKTOP = {"width": 1280, "height": 900}
LONG = "0123456789abcdef" * 6
# Legends have letters of 10 pt, in pictures of 144 dots to the inch.
LETTER_DOTS = 10 / 72 * 144
OPEN = "[...document.querySelectorAll('details')].map((each) => each.open)"


def draw(figure: "Figure") -> None:
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], label="a line")
    axes.legend(fontsize="small")


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Write a report with two folded chapters, a wide table, a table of pairs and a plot."""
    folder: Path = tmp_path_factory.mktemp("report")
    check_can_report(folder)
    rows = [("a case with a name of several words", *["12.25 of 30"] * 9)] * 2
    columns = ("case", *(f"link {number}" for number in range(9)))
    origin = Provenance(
        *("0.1.0", "pure Python", LONG, "2026-01-01T00:00:00+00:00", "host", "platform", "3.11"),
        ["telepulse", "report", f"{LONG}.mcap"],
    )
    chapters = (
        Chapter("In short", tables=(Table("all links", columns, rows),)),
        Chapter(
            "Details",
            ["text"] * 30,
            [Table("pairs", ("name", f"gain ({'N/N, ' * 12})"), [("a", "1.5")])],
            folded=True,
        ),
        Chapter("Plots", plots=(Plot("line", "A line.", draw),)),
    )
    return write_report(Report("A report", chapters, origin), folder).as_uri()


@pytest.fixture
def page(url: str, visit: Visit) -> Iterator[Page]:
    with visit(url) as page:
        assert page.evaluate(OPEN) == [False, False]
        yield page


def test_the_title_of_a_folded_chapter_opens_and_closes_it(page: Page) -> None:
    title = page.locator("summary h2", has_text="Details")
    title.click()
    assert page.evaluate(OPEN) == [True, False]
    title.click()
    assert page.evaluate(OPEN) == [False, False]
    assert page.locator("summary a").count() == 0


def test_the_contents_open_a_folded_chapter_each_time(page: Page) -> None:
    link = page.locator("nav a", has_text="Provenance of this report")
    for _ in range(2):
        link.click()
        page.wait_for_function(f"{OPEN}[1]")
        assert page.locator("summary h2", has_text="Provenance").bounding_box()["y"] < 800
        page.locator("summary h2", has_text="Provenance").click()
        page.wait_for_function(f"!{OPEN}[1]")


def test_an_address_of_a_folded_chapter_opens_it(url: str, visit: Visit) -> None:
    with visit(f"{url}#chapter-2") as page:
        page.wait_for_function(f"{OPEN}[0]")
        assert page.evaluate(OPEN) == [True, False]


def unfold(page: Page) -> None:
    page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")


def test_a_phone_shows_all_tables_without_scrolling_sideways(url: str, visit: Visit) -> None:
    with visit(url, viewport=PHONE) as page:
        unfold(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
        for table in page.locator(".wide").all():
            assert table.evaluate("(it) => it.scrollWidth <= it.clientWidth")
        # Each value stands below the name of its row, with the name of its column.
        row = page.locator("tr", has_text="several words").first
        name, value = (row.locator("td").nth(place) for place in (0, 1))
        assert value.bounding_box()["y"] >= name.bounding_box()["y"] + name.bounding_box()["height"]
        label = "(it) => getComputedStyle(it, '::before').content"
        assert value.evaluate(label) == '"link 0: "'
        assert page.locator("td", has_text="1.5").evaluate(label).startswith('"gain (N/N, N/N')


@pytest.mark.parametrize("viewport", [PHONE, DESKTOP])
def test_letters_of_plots_are_readable(url: str, visit: Visit, viewport: dict[str, int]) -> None:
    for scheme in ("light", "dark"):
        with visit(url, viewport=viewport, color_scheme=scheme) as page:
            image = page.locator("figure img")
            image.scroll_into_view_if_needed()
            page.wait_for_function("document.images[0].complete")
            source = image.evaluate("(it) => it.currentSrc")
            assert source.endswith(f"-{scheme}.png")
            natural, shown, high = image.evaluate(NATURAL_AND_SHOWN)
            assert LETTER_DOTS * shown / natural >= 10
            # Room is reserved before the picture is loaded.
            assert high > 0.4 * shown
            ratio = image.evaluate("(it) => it.width / it.height")
            assert ratio == pytest.approx(shown / high, rel=0.02)


# `naturalWidth` is that of the file: the source states no density.
NATURAL_AND_SHOWN = """async (image) => {
  const file = new Image();
  file.src = image.currentSrc;
  await file.decode();
  const { width, height } = image.getBoundingClientRect();
  return [file.naturalWidth, width, height];
}"""


def test_a_short_value_is_on_one_line(url: str, visit: Visit) -> None:
    with visit(url, viewport=DESKTOP) as page:
        cells = page.locator("tr", has_text="several words").first.locator("td:not(:first-child)")
        assert cells.count() == 9
        assert [cell.evaluate(LINES) for cell in cells.all()] == [1] * 9


LINES = """(cell) => {
  const text = document.createRange();
  text.selectNodeContents(cell);
  return new Set([...text.getClientRects()].map(({ top }) => top)).size;
}"""
