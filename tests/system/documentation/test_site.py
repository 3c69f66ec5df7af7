"""The site builds without a warning, with every page and lesson."""

import re
from pathlib import Path

import pytest

from tests.support.nodes import ROOT, run_python

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
