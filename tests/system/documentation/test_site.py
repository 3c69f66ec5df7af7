"""The site builds without a warning, and needs no other host."""

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

from tests.support.nodes import ROOT, run_python

# Fetched by the browser itself; other links may lead anywhere.
FETCHED = {*((tag, "src") for tag in ("script", "img", "iframe", "source")), ("link", "href")}
NOT_FETCHED = {"canonical", "next", "prev", "search", "index", "author"}


class Fetches(HTMLParser):
    """Parser of the addresses that a page makes a browser fetch."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if given.get("rel") not in NOT_FETCHED:
            self.addresses += [v or "" for k, v in attrs if (tag, k) in FETCHED]


# The lessons are executed as well.
pytestmark = pytest.mark.timeout(400)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site; a warning fails the build."""
    folder = tmp_path_factory.mktemp("site")
    build = run_python(
        *("-m", "sphinx", "-W", "--keep-going", "-n", "-q"),
        *("-d", str(folder / "doctrees"), str(ROOT / "docs"), str(folder / "html")),
        timeout=None,
    )
    assert build.returncode == 0, build.stderr
    return folder / "html"


def test_every_page_is_in_the_site(site: Path) -> None:
    written = {p.relative_to(ROOT / "docs").with_suffix("") for p in (ROOT / "docs").rglob("*.md")}
    built = {p.relative_to(site).with_suffix("") for p in site.rglob("*.html")}
    assert written - built == set()


def test_every_lesson_was_executed(site: Path) -> None:
    lessons = sorted((ROOT / "examples/lessons").glob("*.py"))
    assert lessons
    for lesson in lessons:
        page = (site / "lessons" / lesson.with_suffix(".html").name).read_text(encoding="utf-8")
        assert f"images/sphx_glr_{lesson.stem}_001.png" in page
        assert len(re.findall("sphx-glr-script-out", page)) >= 3
        assert f"{lesson.stem}.ipynb" in page


def test_a_browser_fetches_nothing_from_elsewhere(site: Path) -> None:
    foreign = []
    for page in site.rglob("*.html"):
        fetches = Fetches()
        fetches.feed(page.read_text(encoding="utf-8"))
        foreign += [a for a in fetches.addresses if re.match(r"(https?:)?//", a)]
    for sheet in site.rglob("*.css"):
        text = sheet.read_text(encoding="utf-8")
        foreign += re.findall(r"(?:url\(|@import)\s*['\"]?(?:https?:)?//[^)]*", text)
    assert foreign == []
