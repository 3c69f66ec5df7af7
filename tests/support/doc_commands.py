"""Check that a command could be run: its program accepts the words, and the named files exist."""

import importlib.util
import itertools
import os
import re
import shlex
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import typer

import display_node.cli
import sensing_node.cli
import telepulse.cli.main
from benchmarks.__main__ import main as run_benchmarks
from fuzz.__main__ import fuzz
from protocol.config.scene_file import find_scene
from soak.__main__ import soak
from tests.support.doc_pages import OTHERS
from tests.support.nodes import ROOT

APPLICATIONS = {
    "telepulse": telepulse.cli.main.app,
    "sensing-node": sensing_node.cli.app,
    "display-node": display_node.cli.app,
}
# Variables that `make test-all ARGS=…` exports to the tests, and so to the `make` that they run.
OF_MAKE = {"ARGS", "MAKEFLAGS", "MFLAGS", "MAKEOVERRIDES", "MAKELEVEL"}
# Words in place of a reader's own value.
PLACEHOLDERS = {"PORT": "5600", "PRIORITY": "40", "SECONDS": "1"}
RECIPES = {*OTHERS, "ruff", "mypy", "lint-imports", "touch", "rm", "mkdir"}


def check(command: str) -> None:
    """Raise AssertionError if a command could not be run as written."""
    try:
        _check(command)
    except Exception as error:
        raise AssertionError(f"{command}: {error}") from error


def _check(command: str) -> None:
    words = [_filled(word) for word in shlex.split(command) if word not in ("[SCENE]", "…")]
    # Settings of the environment come before the program.
    program, *rest = itertools.dropwhile(lambda word: re.match(r"[A-Z_]+=", word), words)
    if program in APPLICATIONS:
        _parse(typer.main.get_command(APPLICATIONS[program]), program, rest)
        _scenes_are_there(rest)
    elif program == "make":
        for recipe in recipes(rest):
            _check(recipe)
    elif program == "python":
        _check_module(rest)
    elif program == "pip":
        _check_extras(command)
    elif program == "docker":
        assert rest[0] in ("compose", "run"), command
    else:
        assert program in RECIPES, f"{command}: no program of ours"


def recipes(arguments: list[str]) -> list[str]:
    """Return the commands that `make` would run, without installation."""
    environment = {name: value for name, value in os.environ.items() if name not in OF_MAKE}
    made = subprocess.run(
        ["make", "--dry-run", "--no-print-directory", *arguments],
        cwd=ROOT,
        env=environment,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    assert made.returncode == 0, f"make {shlex.join(arguments)}: {made.stderr}"
    lines = [line.removeprefix(".venv/bin/") for line in made.stdout.splitlines()]
    installs = r"-m (pip|venv)\b|^(touch|rm -f) .venv|^make: "
    return [line for line in lines if not re.search(installs, line)]


def _filled(word: str) -> str:
    for placeholder, value in PLACEHOLDERS.items():
        word = re.sub(rf"\b{placeholder}\b", value, word)
    return word.strip("[]") if re.fullmatch(r"\[--.*|[^\[]*\]", word) else word


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
    assert words[0] == "-m", words
    module, *rest = words[1:]
    found = importlib.util.find_spec(module)
    assert found is not None, f"python -m {module}"
    if module == "benchmarks":
        known = {path.stem for path in (ROOT / "benchmarks").iterdir()}
        names = set(itertools.takewhile(lambda word: not word.startswith("-"), rest))
        assert names <= known, f"no such benchmark: {rest}"
    elif module.startswith("benchmarks."):
        assert found.origin is not None
        text = Path(found.origin).read_text(encoding="utf-8")
        assert all(word in text for word in rest if word.startswith("-")), rest
    mains = {"benchmarks": run_benchmarks, "soak": soak, "fuzz": fuzz}
    if module in mains:
        app = typer.Typer()
        app.command()(mains[module])
        _parse(typer.main.get_command(app), module, rest)


def _check_extras(command: str) -> None:
    document = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    known = document["project"]["optional-dependencies"]
    for extras in re.findall(r"\[([\w,]+)\]", command):
        assert set(extras.split(",")) <= set(known), f"{command}: no such extra"
