"""The page of a report in a real browser, on a phone and on a desktop."""

from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from PIL import Image

from protocol.provenance import Provenance
from telepulse.document import Chapter, Plot, Report, Table, check_can_report, write_report
from tests.support.browser import Visit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PHONE = {"width": 390, "height": 800}
DESKTOP = {"width": 1280, "height": 900}
VIEWPORTS = pytest.mark.parametrize("viewport", [PHONE, DESKTOP], ids=["phone", "desktop"])
LONG = "0123456789abcdef" * 6
LETTERS_PT = 11


def draw(figure: "Figure") -> None:
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], label="a line")
    axes.legend()


@pytest.fixture(scope="module")
def url(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Write a report with two folded chapters, a wide table and a plot."""
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
        Chapter("Details", ["text"] * 30, folded=True),
        Chapter("Plots", plots=(Plot("line", "A line.", draw),)),
    )
    return write_report(Report("A report", chapters, origin), folder).as_uri()


@VIEWPORTS
def test_nothing_but_a_table_is_wider_than_the_screen(
    url: str, visit: Visit, viewport: dict[str, int]
) -> None:
    with visit(url, viewport=viewport) as page:
        page.evaluate("document.querySelectorAll('details').forEach((it) => { it.open = true; })")
        assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]


def test_a_phone_shows_each_value_below_its_row_with_its_columns_name(
    url: str, visit: Visit
) -> None:
    with visit(url, viewport=PHONE) as page:
        row = page.locator("tr", has_text="several words").first
        name, value = (row.locator("td").nth(place) for place in (0, 1))
        assert value.bounding_box()["y"] >= name.bounding_box()["y"] + name.bounding_box()["height"]
        label = value.evaluate("(it) => getComputedStyle(it, '::before').content")
        assert label == '"link 0: "'


@VIEWPORTS
def test_letters_of_a_plot_have_ten_pixels(
    url: str, visit: Visit, viewport: dict[str, int]
) -> None:
    with visit(url, viewport=viewport) as page:
        page.wait_for_function("document.images[0].complete")
        width_pt, shown_px = page.locator("figure img").evaluate(
            "(image) => [image.naturalWidth * 72 / 96, image.getBoundingClientRect().width]"
        )
        assert LETTERS_PT * shown_px / width_pt >= 10


@pytest.mark.parametrize(("scheme", "inked"), [("light", (0, 60)), ("dark", (200, 255))])
def test_a_plot_has_the_ink_of_the_theme(
    url: str, visit: Visit, scheme: str, inked: tuple[int, int]
) -> None:
    with visit(url, color_scheme=scheme) as page:
        drawn = Image.open(BytesIO(page.locator("figure img").screenshot())).convert("L")
    least, most = drawn.getextrema()
    furthest = least if scheme == "light" else most
    assert inked[0] <= furthest <= inked[1]


def test_the_contents_open_a_folded_chapter(url: str, visit: Visit) -> None:
    with visit(url) as page:
        opened = "[...document.querySelectorAll('details')].map((each) => each.open)"
        assert page.evaluate(opened) == [False, False]
        page.locator("nav a", has_text="Details").click()
        page.wait_for_function(f"{opened}[0]")
