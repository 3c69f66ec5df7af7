import re
from importlib.metadata import version
from pathlib import Path

import pytest

from docs.ext.pages import FOLDER, generated
from protocol.refusals import CAUSE_MEANINGS, CONNECTIONS
from protocol.security.budgets import SUBSCRIPTION
from tests.support.nodes import PACKAGES, ROOT

PAGES = [
    path for path in sorted(FOLDER.glob("*.md")) if "<!-- from code" in path.read_text("utf-8")
]
# Other versions of it describe options and defaults in other words.
PINNED = re.findall(
    r"^typer==(.+)$",
    (ROOT / "constraints.txt").read_text("utf-8"),
    re.MULTILINE,
)


def test_every_cause_of_refusal_has_a_meaning_and_no_other() -> None:
    sources = [
        path.read_text(encoding="utf-8") for p in PACKAGES for path in (ROOT / p).rglob("*.py")
    ]
    counted = re.compile(r'(?:WireError\(\s*|cause = |rejected\[|_reject\()"(\w+)"')
    raised = set(counted.findall("\n".join(sources)))
    raised |= {"truncated", "not_msgpack", "version", "duplicate", "overlap"}
    raised |= {SUBSCRIPTION, *CONNECTIONS}
    assert raised == CAUSE_MEANINGS.keys()


def test_the_safety_case_names_existing_tests() -> None:
    text = (ROOT / "docs" / "safety_case.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`(test_\w+\.py)::(test_\w+)`", text))
    assert len(named) > 10
    there = {
        (path.name, test)
        for path in (ROOT / "tests").rglob("test_*.py")
        for test in re.findall(r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE)
    }
    assert named - there == set()


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_line_that_refers_to_a_figure_names_its_paper(page: Path) -> None:
    lines = page.read_text("utf-8").splitlines()
    assert not [line for line in lines if "Fig. " in line and "Dargahi" not in line]


@pytest.mark.parametrize("name", ["README.md", "constraints.txt", "Dockerfile", "pyproject.toml"])
def test_no_address_of_a_registry_is_written_down(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    assert "index-url" not in text
    assert not re.search(r"https?://", text)


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
