"""Compilation of the prediction's kernels: once, in the log, within bounds, and without numba."""

import os
from pathlib import Path

import pytest

from tests.support.nodes import ROOT, run_python

LOGGED = "import logging; logging.basicConfig(level=logging.INFO, format='%(message)s')"
COMPILING = "compiling the kernels of the prediction"
# A stream of three channels with R waves, longer than what every kernel waits for.
EVERY_KERNEL = """
import numpy as np
from display_node.prediction import build_predictors
from display_node.prediction.r_waves import RWaveTime
MS, first, *others = 1_000_000, *build_predictors("stack", 3)
pulse = 0.3 + 0.1 * np.exp(-((np.arange(30_000) % 800 - 260) / 60) ** 2)
for start in range(0, 30_000, 5):
    times_ns, values = [at * MS for at in range(start, start + 5)], pulse[start:start + 5].tolist()
    for channel in (first, *others):
        channel.observe(times_ns, values)
    if start % 800 == 100:
        first.announce([RWaveTime((start - 100) * MS, start * MS)])
    while first.work():
        pass
    assert np.isfinite(first.predict(times_ns[-1] + 100 * MS))
print(round(first.error_n(50 * MS), 4), first.transit.reliable)
"""


def python(script: str, **environment: str) -> tuple[str, str]:
    """Run a script that must succeed; return what it printed and logged."""
    ended = run_python("-c", script, cwd=ROOT, timeout=110, env=os.environ | environment)
    assert ended.returncode == 0, ended.stderr
    return ended.stdout, ended.stderr


def test_kernels_are_compiled_once_and_the_log_says_so(tmp_path: Path) -> None:
    script = f"{LOGGED}; import display_node.prediction.ridge"
    logs = [python(script, NUMBA_CACHE_DIR=str(tmp_path))[1] for _ in range(2)]
    assert [log.count(COMPILING) for log in logs] == [1, 0]
    assert "once on this machine" in logs[0]


def test_no_kernel_leaves_its_arrays(tmp_path: Path) -> None:
    out, _ = python(EVERY_KERNEL, NUMBA_BOUNDSCHECK="1", NUMBA_CACHE_DIR=str(tmp_path))
    assert out.split() == python(EVERY_KERNEL)[0].split()
    assert out.split()[1] == "True"


def test_without_numba_a_display_plays_with_linear_and_says_why() -> None:
    script = f"""
import sys
sys.modules["numba"] = None
{LOGGED}
import telepulse
for display in ({{}}, {{"predictor": "linear"}}):
    print(telepulse.simulate("radial", seconds=3, display=display).force_rmse_n.aligned)
"""
    out, log = python(script)
    stack, linear = map(float, out.split())
    assert stack == pytest.approx(linear)
    assert log.count("numba cannot be loaded") == 1
    assert '"linear" plays in place' in log


@pytest.mark.parametrize("predictor", ["linear", "hold"])
def test_a_scene_whose_predictor_learns_nothing_loads_no_numba(predictor: str) -> None:
    script = f"""
import sys
import telepulse
telepulse.simulate("radial", seconds=1, display={{"predictor": "{predictor}"}})
print("numba" in sys.modules)
"""
    assert python(script)[0].strip() == "False"
