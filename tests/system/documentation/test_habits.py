"""The project's metadata is well-formed and consistent."""

import re
import tomllib
from typing import Any

import yaml

from tests.support.nodes import ROOT, run


def read_yaml(name: str) -> dict[str, Any]:
    document: dict[str, Any] = yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))
    return document


def test_the_hooks_are_well_formed_and_local() -> None:
    name = ".pre-commit-config.yaml"
    checked = run("pre_commit", "validate-config", name)
    assert checked.returncode == 0, checked.stdout
    repositories = read_yaml(name)["repos"]
    assert [r["repo"] for r in repositories] == ["local"]
    assert {hook["language"] for hook in repositories[0]["hooks"]} == {"system"}


def test_the_hooks_run_the_checks_of_make_test() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8").replace("$(BIN)", ".venv/bin")
    assert "\ntest: check\n" in makefile
    recipe = makefile.split("\ncheck:")[1].split("\n\n")[0]
    checks = {line.strip() for line in recipe.splitlines()[1:]}
    hooks = {hook["entry"] for hook in read_yaml(".pre-commit-config.yaml")["repos"][0]["hooks"]}
    assert checks <= hooks
    assert len(checks) == 4


def test_the_citation_names_this_version_and_the_paper() -> None:
    citation = read_yaml("CITATION.cff")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["cff-version"] == "1.2.0"
    assert {"message", "title", "authors"} <= set(citation)
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    (paper,) = citation["references"]
    assert paper["type"] == "article"
    assert (paper["journal"], paper["volume"], paper["year"]) == ("Mechatronics", 18, 2008)


def test_the_changelog_has_its_form() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert text.startswith("# Changelog\n")
    releases = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert releases[0] == "Unreleased"
    assert all(re.fullmatch(r"\d+\.\d+\.\d+ - \d{4}-\d\d-\d\d", name) for name in releases[1:])
    kinds = set(re.findall(r"^### (.+)$", text, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
