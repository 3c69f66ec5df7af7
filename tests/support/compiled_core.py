"""The product with its core compiled, in a folder of its own."""

import os
import shutil
import tomllib
from pathlib import Path

from tests.support.nodes import ROOT, run_python


def build(folder: Path, opt: str) -> None:
    """Copy the product's packages into a folder, and compile the core there."""
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    for package in wheel["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]:
        shutil.copytree(ROOT / package, folder / package)
    shutil.copytree(ROOT / "scenes", folder / "scenes")
    compiler = str(ROOT / "compile_core.py")
    built = run_python(compiler, str(folder), "--opt", opt, timeout=1_500)
    assert built.returncode == 0, built.stdout + built.stderr


def run_in(folder: Path, *arguments: str, timeout: float = 300) -> str:
    """Run Python with the packages of a folder before those of the checkout; return its output."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])}
    ended = run_python(*arguments, cwd=folder, env=environment, timeout=timeout)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout
