"""The reference pages, which a clone and the site show alike, are those of the present code."""

import re
from importlib.metadata import version
from pathlib import Path

import pytest

from docs.ext.pages import FOLDER, generated

PAGES = [
    path for path in sorted(FOLDER.glob("*.md")) if "<!-- from code" in path.read_text("utf-8")
]
# Other versions of it describe options and defaults in other words.
PINNED = re.findall(
    r"^typer==(.+)$",
    (Path(__file__).parents[3] / "constraints.txt").read_text("utf-8"),
    re.MULTILINE,
)


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_reference_page_is_what_the_code_gives(
    page: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if page.stem == "commands" and [version("typer")] != PINNED:
        pytest.skip("typer is not of the version in constraints.txt")
    monkeypatch.setenv("COLUMNS", "40")
    text = page.read_text("utf-8")
    assert generated(text) == text, "python -m docs.ext writes it again"


def test_the_pages_that_a_clone_shows_hold_their_tables() -> None:
    assert {page.stem for page in PAGES} == {"commands", "scenes", "summary", "wire"}
    for page in PAGES:
        assert page.read_text("utf-8").count("\n| ") > 20
        assert "{from-code}" not in page.read_text("utf-8")
