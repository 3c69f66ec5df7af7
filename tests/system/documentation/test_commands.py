"""Every command on a page is parsed by the real command line; those marked as run are run."""

import itertools
import os
import re
import shlex
import subprocess
import tomllib
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import typer

import display_node.cli
import sensing_node.cli
import telepulse.cli.main
from benchmarks.__main__ import main as benchmarks
from benchmarks.__main__ import questions
from fuzz.__main__ import fuzz
from protocol.config.scene_file import find_scene
from soak.__main__ import soak
from tests.support.doc_pages import OTHERS, blocks, commands, commands_in_text
from tests.support.nodes import ROOT, run_python

APPLICATIONS = {
    "telepulse": telepulse.cli.main.app,
    "sensing-node": sensing_node.cli.app,
    "display-node": display_node.cli.app,
}
TYPED = sorted({c for block in blocks() if block.is_shell for c in commands(block)})
# Variables that `make test-all ARGS=…` exports to the tests, and so to the `make` that they run.
OF_MAKE = {"ARGS", "MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES", "MAKELEVEL"}
# Words in place of a reader's own value.
PLACEHOLDERS = {"PORT": "5600", "PRIORITY": "40", "SECONDS": "1"}
RECIPES = {*OTHERS, "ruff", "mypy", "lint-imports", "touch", "rm", "mkdir", "docker"}


def check(command: str) -> None:
    """Raise AssertionError if a command could not be run as written."""
    words = [_filled(word) for word in shlex.split(command) if word not in ("[SCENE]", "…")]
    # Settings of the environment come before the program.
    program, *rest = itertools.dropwhile(lambda word: re.match(r"[A-Z_]+=", word), words)
    try:
        if program in APPLICATIONS:
            _parse(typer.main.get_command(APPLICATIONS[program]), program, rest)
            _scenes_are_there(rest)
        elif program == "make":
            for recipe in _recipes(rest):
                check(recipe)
        elif program == "python":
            _check_module(rest)
        elif program == "pip":
            _check_extras(command)
        else:
            assert program in RECIPES, "no program of ours"
    except Exception as error:
        raise AssertionError(f"{command}: {error}") from error


def _filled(word: str) -> str:
    for placeholder, value in PLACEHOLDERS.items():
        word = re.sub(rf"\b{placeholder}\b", value, word)
    return word.strip("[]") if re.fullmatch(r"\[--.*|[^\[]*\]", word) else word


def _recipes(arguments: list[str]) -> list[str]:
    """Return the commands that `make` would run, without installation."""
    environment = {name: value for name, value in os.environ.items() if name not in OF_MAKE}
    command = ["make", "--dry-run", "--no-print-directory", *arguments]
    made = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, encoding="utf-8", check=False
    )
    assert made.returncode == 0, made.stderr
    lines = [line.removeprefix(".venv/bin/") for line in made.stdout.splitlines()]
    installs = r"-m (pip|venv)\b|^(touch|rm -f) .venv|^make: "
    return [line for line in lines if not re.search(installs, line)]


def _parse(command: Any, name: str, words: list[str]) -> None:
    """Parse the words by the real command line, down to the sub-command, without running it."""
    # Some of these act when parsed.
    if words in ([], ["--help"], ["--version"], ["--install-completion"]) or words[-1:] == [""]:
        return
    context = command.make_context(name, list(words))
    if hasattr(command, "commands"):
        inner_words = [*context._protected_args, *context.args]
        inner_name, inner, rest = command.resolve_command(context, inner_words)
        # `telepulse calibrate`, in a sentence, is the command's name.
        if rest:
            _parse(inner, inner_name, rest)


def _scenes_are_there(words: list[str]) -> None:
    for word in words:
        if match := re.fullmatch(r"(?:scenes|SCENES)/(\w+\.toml)", word):
            assert (ROOT / "scenes" / match[1]).exists(), f"no such scene: {word}"
    if words[0] in ("simulate", "tune", "demo", "bench") and len(words) > 1:
        name = words[1]
        if name.islower() and "." not in name and not name.startswith("-"):
            find_scene(name)


def _check_module(words: list[str]) -> None:
    if words[0].endswith(".py"):
        assert (ROOT / words[0]).exists(), f"no such program: {words[0]}"
        return
    assert words[0] == "-m", words
    module, *rest = words[1:]
    spec = find_spec(module)
    assert spec is not None, f"no module {module}"
    runs = {"soak": soak, "fuzz": fuzz, "benchmarks": benchmarks}
    if module not in runs:
        # A module of ours that only defines would end silently.
        package = spec.submodule_search_locations is not None
        source = "" if package else Path(spec.origin or "").read_text(encoding="utf-8")
        assert package or '__name__ == "__main__"' in source, f"{module} runs nothing"
        return
    app = typer.Typer()
    app.command()(runs[module])
    _parse(typer.main.get_command(app), module, rest)
    if module == "benchmarks":
        chosen = {word for word in rest if word in questions()}
        first = [word for word in rest[:1] if not word.startswith("-")]
        assert set(first) <= chosen, f"no such benchmark: {first}"


def _check_extras(command: str) -> None:
    document = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    known = document["project"]["optional-dependencies"]
    for extras in re.findall(r"\[([\w,]+)\]", command):
        assert set(extras.split(",")) <= set(known), "no such extra"


@pytest.mark.parametrize("command", TYPED)
def test_a_command_of_a_page_is_valid(command: str) -> None:
    check(command)


def test_commands_in_sentences_are_valid() -> None:
    found = list(commands_in_text())
    assert len(found) > 50
    for command in found:
        check(command)


def test_the_command_line_imports_a_commands_modules_only_for_that_command() -> None:
    loaded = run_python("-c", "import sys; import telepulse.cli.main; print(*sys.modules)").stdout
    assert "typer" in loaded.split()
    assert "display_node" not in loaded.split()
