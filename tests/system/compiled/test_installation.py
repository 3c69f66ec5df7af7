"""The compiled installation follows the sources, and neither installation hides the other."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.support.nodes import ROOT

COPIED = ("Makefile", "pyproject.toml", "constraints.txt", "compile_core.py", "hatch_build.py")
PACKAGES = (
    "protocol",
    "pulse_sensors",
    "pulse_drives",
    "sensing_node",
    "display_node",
    "telepulse",
    "scenes",
)
EARLIER_S, INSTALLED_S, LATER_S = 1_000_000_000, 1_000_000_100, 1_000_000_200


def checkout(folder: Path, stamp: str) -> Path:
    """Make a checkout that was installed after its last change; return one of its sources."""
    for name in COPIED:
        shutil.copy(ROOT / name, folder / name)
    for package in PACKAGES:
        (folder / package).mkdir()
        (folder / package / "module.py").touch()
    (folder / ".venv" / "bin").mkdir(parents=True)
    (folder / ".venv" / "bin" / "python").touch()
    for path in folder.rglob("*"):
        os.utime(path, (EARLIER_S, EARLIER_S))
    (folder / ".venv" / stamp).touch()
    os.utime(folder / ".venv" / stamp, (INSTALLED_S, INSTALLED_S))
    return folder / "display_node" / "module.py"


def recipe(folder: Path, *arguments: str) -> str:
    environment = {name: text for name, text in os.environ.items() if not name.startswith("MAKE")}
    command = ["make", "--dry-run", "install", *arguments]
    made = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, encoding="utf-8", check=True
    )
    return made.stdout


@pytest.mark.smoke
def test_a_changed_source_is_compiled_anew(tmp_path: Path) -> None:
    source = checkout(tmp_path, "installed-compiled")
    assert "pip" not in recipe(tmp_path, "COMPILED=1")
    os.utime(source, (LATER_S, LATER_S))
    made = recipe(tmp_path, "COMPILED=1")
    assert "TELEPULSE_COMPILED=1" in made
    assert " -e " not in made


def test_either_installation_replaces_the_other(tmp_path: Path) -> None:
    checkout(tmp_path, "installed-compiled")
    made = recipe(tmp_path)
    assert " -e " in made
    assert "rm -f .venv/installed-compiled" in made
    (tmp_path / ".venv" / "installed-compiled").rename(tmp_path / ".venv" / "installed")
    assert "rm -f .venv/installed .venv/installed-*" in recipe(tmp_path, "COMPILED=1")
