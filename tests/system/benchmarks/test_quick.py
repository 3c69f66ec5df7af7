"""Each benchmark runs every part of itself with little effort."""

import pytest

from tests.support.nodes import run_python

NAMES = (
    "announce",
    "depth",
    "first_seconds",
    "in_phase",
    "loop",
    "peers",
    "playout",
    "prediction",
    "press",
)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", NAMES)
def test_a_quick_run_prints_its_tables(name: str) -> None:
    ran = run_python("-m", "benchmarks", name, "--quick", timeout=300)
    assert ran.returncode == 0, ran.stderr
    assert "─" in ran.stdout
