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
    assert "{from-code}" not in text
    assert generated(text) == text, "python -m docs.ext writes it again"
