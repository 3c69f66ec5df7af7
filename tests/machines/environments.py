"""Environments of the variants, kept for the next run until what they hold changes."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
# Not in the checkout: a fresh one uses them too, and an ordinary user may enter.
KEPT = Path(tempfile.gettempdir()) / "telepulse-machines"
# Where Pythons lie besides those on the path.
FOLDERS = (
    *(Path("/usr/bin"), Path("/usr/local/bin")),
    *Path.home().glob(".pyenv/versions/*/bin"),
    *Path.home().glob(".local/share/uv/python/*/bin"),
)
MINORS = range(11, 15)
DISPATCH = """
import json
from numpy._core._multiarray_umath import __cpu_dispatch__ as levels, __cpu_features__ as there
print(json.dumps([level for level in levels if there.get(level)]))
"""


class UnavailableError(Exception):
    """What a variant needs is not here."""


@dataclass(frozen=True)
class Python:
    """An interpreter that is installed."""

    path: str
    version: tuple[int, int, int]

    def __str__(self) -> str:
        return ".".join(map(str, self.version))


def output(*command: str) -> str:
    """Return what a command prints. Raises UnavailableError with its last error."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or ["no reason given"]
        raise UnavailableError(next((line for line in lines[::-1] if "rror" in line), lines[-1]))
    return done.stdout


def _read(path: Path) -> Python | None:
    try:
        text = output(str(path), "-c", "import sys; print(*sys.version_info[:3])")
    except UnavailableError:
        return None
    major, minor, micro = map(int, text.split())
    return Python(str(path), (major, minor, micro))


def pythons() -> list[Python]:
    """Return each Python of this machine that is new enough, one a version, the oldest first."""
    found = {}
    for folder in (*map(Path, os.environ["PATH"].split(os.pathsep)), *FOLDERS):
        for minor in MINORS:
            path = folder / f"python3.{minor}"
            if path.exists() and (python := _read(path)) is not None:
                found.setdefault(python.version, python)
    return [found[version] for version in sorted(found)]


def own() -> Python:
    """Return the Python that runs this."""
    return Python(getattr(sys, "_base_executable", sys.executable), sys.version_info[:3])


def is_open(path: Path) -> bool:
    """Return whether an ordinary user may enter a folder, or run a program."""
    real = path.resolve()
    return all(each.stat().st_mode & 0o001 for each in (real, *real.parents) if each.exists())


def declared() -> dict[str, Any]:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    project: dict[str, Any] = tomllib.loads(text)["project"]
    return project


def lowest() -> str:
    """Return constraints that hold the product and its tests to the lowest declared versions."""
    project = declared()
    extras = project["optional-dependencies"].values()
    wanted = "\n".join((*project["dependencies"], *(each for extra in extras for each in extra)))
    found = re.findall(r"^([\w-]+)(?:\[.*\])?>=([\w.]+)$", wanted, re.MULTILINE)
    return "\n".join(f"{name}=={version}" for name, version in found)


def environment(python: Python, versions: str = "pinned") -> Path:
    """Return a folder with the tests' dependencies: "pinned", "lowest" or "newest"."""
    constraints = {
        "pinned": lambda: (ROOT / "constraints.txt").read_text(encoding="utf-8"),
        "lowest": lowest,
        "newest": lambda: "",
    }[versions]()
    today = str(date.today()) if versions == "newest" else ""
    key = "\0".join((str(python), python.path, json.dumps(declared()), constraints, today))
    folder = KEPT / f"{versions}-{python}-{hashlib.sha256(key.encode()).hexdigest()[:12]}"
    if (folder / "complete").exists():
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    output(python.path, "-m", "venv", str(folder))
    held = folder / "constraints.txt"
    held.write_text(constraints, encoding="utf-8")
    install(folder, "-c", str(held), "-e", f"{ROOT}[test]")
    (folder / "complete").touch()
    return folder


def install(folder: Path, *arguments: str) -> None:
    """Install into an environment."""
    pip = ("-m", "pip", "--quiet", "--disable-pip-version-check", "install")
    output(str(folder / "bin" / "python"), *pip, *arguments)


def dispatch_levels(folder: Path) -> list[str]:
    """Return the levels of the processor that numpy of an environment uses above its baseline."""
    levels: list[str] = json.loads(output(str(folder / "bin" / "python"), "-c", DISPATCH))
    return levels
