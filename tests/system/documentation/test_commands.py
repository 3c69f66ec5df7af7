"""Every command on a page is run, or parsed by the real command line and listed with a reason."""

import re
from pathlib import Path

import pytest

from tests.support.doc_commands import check
from tests.support.doc_output import SESSIONS, UNRUN
from tests.support.doc_pages import Block, blocks, commands, commands_in_text
from tests.support.doc_sessions import Session, Step
from tests.support.nodes import ROOT, run_python

TYPED = {
    command: block.place for block in blocks() if block.is_shell for command in commands(block)
}
RUN = {step.command for steps in SESSIONS.values() for step in steps if isinstance(step, Step)}


def test_every_command_is_run_or_named_with_a_reason() -> None:
    unknown = {command: place for command, place in TYPED.items() if command not in {*RUN, *UNRUN}}
    assert unknown == {}


def test_every_reason_belongs_to_a_command() -> None:
    assert set(UNRUN) - set(TYPED) == set()
    assert set(UNRUN) & RUN == set()
    named = [path for reason in UNRUN.values() for path in re.findall(r"tests/\S+", reason)]
    assert [path for path in named if not (ROOT / path).exists()] == []


@pytest.mark.parametrize("command", sorted(UNRUN))
def test_commands_that_are_not_run_are_valid(command: str) -> None:
    check(command)


def test_commands_in_sentences_are_valid() -> None:
    found = list(commands_in_text())
    assert len(found) > 50
    for command in found:
        check(command)


# A busy machine takes seconds to start each of its processes.
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("goes_first")
@pytest.mark.parametrize("name", SESSIONS)
def test_a_session_of_commands_succeeds(name: str, tmp_path: Path) -> None:
    Session(tmp_path).play(SESSIONS[name])


@pytest.mark.parametrize(
    "command",
    [
        "telepulse simulate radial --secnds 3",
        "telepulse simulat radial",
        "telepulse simulate radical",
        "sensing-node scenes/gone.toml",
        "make dmo",
        "make bench ARGS=wires",
        "pip install 'telepulse[reord]'",
        "python -m benchmark",
    ],
)
def test_invalid_commands_are_found(command: str) -> None:
    with pytest.raises(AssertionError):
        check(command)


def test_comments_prompts_and_output_are_not_commands() -> None:
    block = Block("page.md", 1, "console", "$ telepulse demo \\\n  --no-ui  # here\nout put\n")
    assert list(commands(block)) == ["telepulse demo --no-ui"]


def test_the_command_line_imports_a_commands_modules_only_for_that_command() -> None:
    loaded = run_python("-c", "import sys; import telepulse.cli.main; print(*sys.modules)").stdout
    assert "typer" in loaded.split()
    assert "display_node" not in loaded.split()
