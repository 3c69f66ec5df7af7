"""Compile the modules that `pyproject.toml` lists under [tool.telepulse] with mypyc.

`python compile_core.py FOLDER` writes the extension modules into FOLDER, which then belongs beside
the sources, in a wheel or on a path before them. It needs mypy, setuptools, a C compiler, and
Python's headers; `hatch_build.py` calls it when a wheel is built.
"""

import argparse
import logging
import os
import shlex
import shutil
import sys
import sysconfig
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parent
# mypy's own results of the last build, apart from those of `make check`.
CACHE = ROOT / ".mypy_cache" / "compiled"
GROUP = "telepulse"


def compiled_modules() -> list[str]:
    """Return the paths of the modules to compile, from the root."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    modules: list[str] = settings["tool"]["telepulse"]["compiled"]
    return modules


def missing() -> str | None:
    """Return what is missing on this machine to compile; None if nothing is."""
    compiler = shlex.split(os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc")[0]
    if shutil.which(compiler) is None:
        return f"a C compiler ({compiler})"
    if not (Path(sysconfig.get_paths()["include"]) / "Python.h").exists():
        return "Python's headers (python3-dev)"
    return None


def compile_into(folder: Path, opt_level: str) -> None:
    """Compile the modules into a folder, at an optimisation level of "0" to "3"."""
    from mypyc.build import mypycify
    from setuptools import Distribution  # type: ignore[import-untyped]

    folder = folder.resolve()
    os.chdir(ROOT)
    # Errors are those of `make check`; here, other libraries may be installed.
    options = ["--config-file=pyproject.toml", f"--cache-dir={CACHE}", "--follow-imports=silent"]
    options += ["--ignore-missing-imports", "--no-warn-unused-ignores", "--no-warn-return-any"]
    with tempfile.TemporaryDirectory() as temporary:
        extensions = mypycify(
            [*options, *compiled_modules()],
            opt_level=opt_level,
            group_name=GROUP,
            debug_level="0",
            multi_file=True,
            target_dir=temporary,
        )
        build = Distribution({"name": GROUP, "ext_modules": extensions}).get_command_obj(
            "build_ext"
        )
        build.build_lib, build.build_temp = str(folder), temporary
        # One process a core: each module is a C file of its own.
        build.parallel = os.cpu_count()
        build.ensure_finalized()
        build.run()


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="folder for the extension modules")
    parser.add_argument("--opt", default="2", choices="0123", help="optimisation level")
    chosen = parser.parse_args()
    if (lacking := missing()) is not None:
        sys.exit(
            f"compile_core: {lacking} is missing; install it, or leave TELEPULSE_COMPILED and"
            " COMPILED out for pure Python"
        )
    logging.disable(logging.INFO)
    compile_into(chosen.folder, chosen.opt)


if __name__ == "__main__":
    main()
