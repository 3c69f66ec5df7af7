"""What runs on Windows and macOS, as far as Linux can show it: without what Python lacks there."""

import json
import os
from subprocess import CompletedProcess

import pytest

from tests.support.nodes import PACKAGES, ROOT, assert_accounted, run_python

FOLDER = ROOT / "tests/support/platforms"
PLATFORMS = ("win32", "darwin")
MAIN = "import sys; from telepulse.cli.main import main; sys.argv[0] = 'telepulse'; main()"
IMPORT_ALL = """
import importlib, pkgutil, sys
for name in sys.argv[1:]:
    package = importlib.import_module(name)
    for module in pkgutil.walk_packages(package.__path__, name + "."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
print("imported")
"""


def run_on(platform: str, *arguments: str) -> "CompletedProcess[str]":
    """Run Python as if on another platform, with its child processes."""
    paths = os.pathsep.join((str(FOLDER), str(ROOT)))
    changed = {"TELEPULSE_TEST_PLATFORM": platform, "PYTHONPATH": paths}
    return run_python(*arguments, env=os.environ | changed)


@pytest.mark.parametrize("platform", PLATFORMS)
def test_every_module_is_imported(platform: str) -> None:
    done = run_on(platform, "-c", IMPORT_ALL, *PACKAGES)
    assert done.stdout == "imported\n", done.stderr


@pytest.mark.parametrize("platform", PLATFORMS)
def test_both_nodes_run_over_a_link_and_account_for_each_sample(platform: str) -> None:
    command = ("demo", "--seconds", "4", "--no-ui", "--link", "delay=5ms", "--json", "-")
    done = run_on(platform, "-c", MAIN, *command)
    assert done.returncode == 0, done.stderr
    assert_accounted(json.loads(done.stdout)["samples"])


def test_what_needs_another_platform_is_refused_in_one_line() -> None:
    done = run_on("win32", "-c", MAIN, "emulate", "sensor", "radial")
    assert done.returncode == 2
    assert done.stderr.startswith("telepulse: Windows has no pseudo-terminals")
    assert len(done.stderr.splitlines()) == 1
