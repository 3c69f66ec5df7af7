"""The blocks of the pages: tables are valid in a scene, snippets and marked commands run."""

import json
import re
import shlex
import shutil
import sysconfig
import tomllib
from pathlib import Path
from subprocess import PIPE, STDOUT
from typing import Any

import pytest
import yaml

from display_node.scene import DisplayScene
from protocol.config.scene import validate
from protocol.config.scene_file import find_scene, load_document
from protocol.host.child_process import ChildProcess
from sensing_node.scene import SensingScene
from telepulse.simulation.link_scene import LinkScene
from tests.support.doc_pages import Block, blocks, commands
from tests.support.nodes import ROOT, run_python
from tests.support.recordings import record

BLOCKS = list(blocks())
SECTIONS = {"sensing": SensingScene, "display": DisplayScene, "link": LinkScene}
TABLES = [b for b in BLOCKS if b.language == "toml" or not (b.language or b.is_shell)]
DATA = [b for b in BLOCKS if b.language in ("json", "yaml")]
PYTHON = "python"
RUN = sorted({b.page for b in BLOCKS if b.language == PYTHON or b.run})
BIN = Path(sysconfig.get_path("scripts"))
LONGEST_S = 120
# Values of snippets that would take too long in a test.
SHORTER = {"SECONDS = 60": "SECONDS = 2"}


def tables(text: str) -> list[dict[str, Any]]:
    """Return the tables of a block of TOML, which may show one table in two ways."""
    try:
        return [tomllib.loads(text)]
    except tomllib.TOMLDecodeError:
        return [tomllib.loads(part) for part in re.split(r"\n\n", text)]


@pytest.mark.parametrize("block", TABLES, ids=lambda block: block.place)
def test_a_table_is_valid_within_a_shipped_scene(block: Block) -> None:
    for table in tables(block.text):
        base = "real_bench" if "observer" in str(table) else "radial"
        scene = load_document(find_scene(base))
        for section, schema in SECTIONS.items():
            if section in table:
                validate(merged(scene.get(section, {}), table[section]), schema, block.place)


def merged(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Merge `above` into `below`; a table with another kind replaces the whole table."""
    if "kind" in above:
        return above
    result = dict(below)
    for key, value in above.items():
        inner = isinstance(value, dict)
        result[key] = merged(below.get(key, {}), value) if inner else value
    return result


# A busy machine takes seconds to start each of its processes.
@pytest.mark.timeout(400)
@pytest.mark.parametrize("page", RUN)
def test_a_page_runs_from_top_to_bottom(page: str, tmp_path: Path) -> None:
    """Run its marked commands and its snippets in one folder, with the scenes and a recording."""
    shutil.copytree(ROOT / "scenes", tmp_path / "scenes")
    record(tmp_path / "pulse.mcap", seconds=10)
    here = [block for block in BLOCKS if block.page == page]
    for block, following in zip(here, [*here[1:], None], strict=True):
        if block.language == PYTHON:
            run_snippet(block, following, tmp_path)
        elif block.run:
            for command in commands(block):
                run_command(command, tmp_path)


def run_command(command: str, folder: Path) -> None:
    program, *words = shlex.split(command)
    path = str(BIN / program)
    with ChildProcess(path, path, *words, cwd=folder, stdout=PIPE, stderr=STDOUT) as child:
        output, _ = child.communicate(timeout=LONGEST_S)
    assert child.returncode == 0, f"{command}\n{output}"


def run_snippet(block: Block, following: Block | None, folder: Path) -> None:
    """Run a page's Python; it prints what the page shows below it."""
    text = block.text
    for long, short in SHORTER.items():
        text = text.replace(long, short)
    # A file, as a reader saves it: other processes import it.
    (folder / "snippet.py").write_text(text, encoding="utf-8")
    run = run_python("snippet.py", cwd=folder, timeout=LONGEST_S)
    assert run.returncode == 0, run.stderr
    if text == block.text and following is not None and following.language == "text":
        assert run.stdout == following.text


def test_data_is_valid_in_its_language() -> None:
    for block in DATA:
        {"json": json.loads, "yaml": yaml.safe_load}[block.language](block.text)


def test_the_site_links_to_no_page_that_is_gone() -> None:
    """README and CONTRIBUTING are not part of the site, whose links Sphinx checks."""
    for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"):
        page = ROOT / name
        targets = re.findall(r"\]\(([^)#:]+)\)", page.read_text(encoding="utf-8"))
        assert [target for target in targets if not (ROOT / target).exists()] == []
