"""Every block of the pages is of a kind that a test can check."""

import ast
import json
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from display_node.scene import DisplayScene
from protocol.config.scene import validate
from protocol.config.scene_file import find_scene, load_document
from sensing_node.scene import SensingScene
from telepulse.simulation.link_scene import LinkScene
from tests.support.doc_pages import PYTHON, Block, blocks
from tests.support.nodes import ROOT, run_python

BLOCKS = list(blocks())
SECTIONS = {"sensing": SensingScene, "display": DisplayScene, "link": LinkScene}
# Neither commands nor data of ours: bytes, output, files of other programs.
SHOWN = {
    ("docs/wire.md", "[2, session, first_sample"),
    ("docs/fuzzing.md", "frame "),
    ("docs/realtime.md", "USER - rtprio"),
    ("docs/discovery.md", "looking for a sensing node"),
}
# First words of code that needs root and iperf3; tests/system/links runs it.
UNRUN = ("with emulate(",)
# Its snippets read the output of its commands: `doc_output.py` runs them after those.
READS = "docs/analysis.md"
# Values of snippets that would take too long in a test.
SHORTER = {"SECONDS = 60": "SECONDS = 2"}


def snippets() -> list[Block]:
    python = (b for b in BLOCKS if b.language == PYTHON or (not b.language and is_python(b.text)))
    return [b for b in python if b.page != READS]


def is_python(text: str) -> bool:
    try:
        return any(isinstance(part, ast.With | ast.Import) for part in ast.parse(text).body)
    except SyntaxError:
        return False


def tables(text: str) -> list[dict[str, Any]]:
    """Return the tables of a block of TOML, which may show one table in two ways."""
    try:
        return [tomllib.loads(text)]
    except tomllib.TOMLDecodeError:
        return [tomllib.loads(part) for part in re.split(r"\n\n", text)]


def kind(block: Block) -> str:
    """Return the kind of a block. Raises for an unknown kind."""
    if block.is_shell:
        return "shell"
    if block.language.startswith(("{", "text", "promql")):
        return "shown"
    if block.language in (PYTHON, "toml", "json", "yaml"):
        return block.language
    if is_python(block.text):
        return PYTHON
    if any(block.page == page and block.text.startswith(words) for page, words in SHOWN):
        return "shown"
    tables(block.text)
    return "toml"


@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.place)
def test_a_block_is_valid_in_its_language(block: Block) -> None:
    match kind(block):
        case "toml":
            for table in tables(block.text):
                check_scene(table, block.place)
        case "json":
            json.loads(block.text)
        case "yaml":
            yaml.safe_load(block.text)


def check_scene(table: dict[str, Any], where: str) -> None:
    """Check that a table is valid within a shipped scene."""
    base = "real_bench" if "observer" in str(table) else "radial"
    scene = load_document(find_scene(base))
    for section, schema in SECTIONS.items():
        if section in table:
            validate(merged(scene.get(section, {}), table[section]), schema, where)


def merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Merge `above` into `below`; a table with another kind replaces the whole table."""
    if "kind" in above:
        return above
    result = dict(below)
    for key, value in above.items():
        inner = isinstance(value, dict)
        result[key] = merged(below.get(key, {}), value) if inner else value
    return result


@pytest.mark.parametrize("block", snippets(), ids=lambda block: block.place)
def test_a_snippet_runs_and_prints_what_the_page_shows(block: Block, tmp_path: Path) -> None:
    if block.text.startswith(UNRUN):
        return
    text = block.text
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    # A file, as a reader saves it: other processes import it.
    (tmp_path / "snippet.py").write_text(text, encoding="utf-8")
    run = run_python("snippet.py", cwd=tmp_path, timeout=None)
    assert run.returncode == 0, run.stderr
    after = [b for b in BLOCKS if b.page == block.page and b.line > block.line]
    if text == block.text and after and after[0].language == "text":
        assert run.stdout == after[0].text


def test_the_site_links_to_no_page_that_is_gone() -> None:
    """README and CONTRIBUTING are not part of the site, whose links Sphinx checks."""
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        page = ROOT / name
        targets = re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8"))
        assert [target for target in targets if not (ROOT / target).exists()] == []
