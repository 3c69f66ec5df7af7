"""The compiled core, built in a folder of its own: it computes what the pure one does."""

import json
import os
from pathlib import Path

import pytest

from compile_core import compiled_modules, missing
from tests.golden.runs import runs
from tests.support.compiled_core import build, run_in
from tests.support.nodes import ROOT, run_python

pytestmark = pytest.mark.timeout(900)

# Prints the figures of the golden runs, from the compiled modules alone.
RUNS = """
import json
from importlib import import_module
from sys import argv
from tests.golden.runs import runs
for name in argv[1:]:
    assert not import_module(name).__file__.endswith(".py"), name
print(json.dumps(runs()))
"""
VERSION = "import sys; sys.argv = ['x', '--version']; from {} import main; main()"
PROGRAMS = ("telepulse.cli.main", "sensing_node.cli", "display_node.cli")


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the product's packages and their compiled modules.

    Compiled without optimisation, which takes half the time; x86-64 and ARM compute the same.
    """
    if (lacking := missing()) is not None:
        pytest.skip(f"{lacking} is missing")
    folder = tmp_path_factory.mktemp("compiled")
    build(folder, opt="0")
    return folder


def test_compiled_and_pure_runs_have_the_same_figures_to_the_last_digit(compiled: Path) -> None:
    names = [path.removesuffix(".py").replace("/", ".") for path in compiled_modules()]
    figures = json.loads(run_in(compiled, "-c", RUNS, *names))
    for name, pure in runs().items():
        assert figures[name] == pure, name


@pytest.mark.parametrize("module", PROGRAMS)
def test_each_program_says_that_it_is_compiled(compiled: Path, module: str) -> None:
    assert run_in(compiled, "-c", VERSION.format(module)).rstrip().endswith(", compiled")


# mypyc refuses to make an object of a class in pure Python that has a compiled base.
PURE_CLASSES_WITH_A_COMPILED_BASE = """
import inspect, pkgutil, sys
from importlib import import_module
NODES = ("sensing_node", "display_node")
PACKAGES = ("protocol", "pulse_sensors", "pulse_drives", *NODES, "telepulse")
for package in map(import_module, PACKAGES):
    for found in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not found.name.endswith("__main__"):
            import_module(found.name)
ours = {name: module for name, module in sys.modules.items() if name.split(".")[0] in PACKAGES}
compiled = {name for name, module in ours.items() if not module.__file__.endswith(".py")}
for name in ours.keys() - compiled:
    for _, kind in inspect.getmembers(ours[name], inspect.isclass):
        if kind.__module__ == name and {base.__module__ for base in kind.__mro__} & compiled:
            print(name, kind.__name__)
"""


def test_no_class_in_pure_python_has_a_compiled_base(compiled: Path) -> None:
    assert run_in(compiled, "-c", PURE_CLASSES_WITH_A_COMPILED_BASE) == ""


def test_no_compiled_module_is_left_in_the_checkout(compiled: Path) -> None:
    folders = [path for path in ROOT.iterdir() if path.is_dir() and path.name != ".venv"]
    assert [path for folder in folders for path in folder.rglob("*.cpython-*.so")] == []
    assert list(ROOT.glob("*.so")) == []


def test_without_a_compiler_one_line_says_what_to_do(tmp_path: Path) -> None:
    environment = os.environ | {"CC": "no-such-compiler"}
    ended = run_python(str(ROOT / "compile_core.py"), str(tmp_path), env=environment)
    assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (1, "", 1)
    assert "a C compiler (no-such-compiler) is missing" in ended.stderr
