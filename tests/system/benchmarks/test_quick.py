"""Each benchmark runs every part of itself with little effort."""

import subprocess
import sys

import pytest

from tests.support.nodes import ROOT

NAMES = ("announce", "cost", "integrators", "link", "playout", "prediction")


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", NAMES)
def test_a_quick_run_prints_its_tables(name: str) -> None:
    command = [sys.executable, "-m", "benchmarks", name, "--quick"]
    ran = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False
    )
    assert ran.returncode == 0, ran.stderr
    assert "─" in ran.stdout
