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


# A line that each lesson prints, with a figure, its value and how far off it may be. They are known
# otherwise: from the paper, from theory, or from what the lesson has drawn.
FIGURES = {
    # Of 28 trials with a share of 3/4, 19 or more are right in 80 % of the cases; by guessing, in
    # less than 5 %.
    "blinded_trials": (r"right 75% of the time: (\d+) trials", 28, 0),
    # The summary of the same run.
    "buffer_or_predict": (r"summary: ([\d.]+) mN", 5.65, 0.5),
    # Two first-order corners: half the power at the upper one.
    "film_amplifier": (r"94\.57 Hz: ([\d.]+)%", 70.7, 0.1),
    # Fig. 16.
    "paper_numbers": (r"energy below  5\.0 Hz: paper  57\.4%, here  ([\d.]+)%", 57.4, 0.5),
    # Beats were drawn 0.85 s apart.
    "your_recording": (r"median rate (\d+) /min", 60 / 0.85, 3),
}


@pytest.mark.parametrize("lesson", sorted((ROOT / "examples/lessons").glob("*.py")), ids=str)
def test_a_lesson_prints_a_figure_that_is_known(site: Path, lesson: Path) -> None:
    page = (site / "lessons" / lesson.with_suffix(".html").name).read_text(encoding="utf-8")
    line, value, off = FIGURES[lesson.stem]
    found = re.search(line, page)
    assert found is not None, line
    assert float(found[1]) == pytest.approx(value, abs=off)


def test_a_notebook_s_cell_that_ends_in_a_run_shows_it(site: Path) -> None:
    page = (site / "lessons/your_recording.html").read_text(encoding="utf-8")
    assert "The finger felt the pulse" in page
    assert 'src="data:image/png;base64,' in page
