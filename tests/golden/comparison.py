"""Comparison of figures with those of another machine, within a tolerance that was measured.

`python -m tests.golden sensitivity` runs each golden scene with sums that are rounded otherwise,
and with other kernels of numpy and BLAS where the processor has them. `sensitivity.json` holds the
largest relative change of each figure, by scene. A figure that is not there did not change.
"""

import json
import os
from collections.abc import Iterator
from typing import Any

from tests.golden.rounding import rounded_otherwise
from tests.golden.runs import SCENES, SEEDS, runs
from tests.support.nodes import run_python

# A change of the product shows at a millionth of a figure and far below. Rounding stays far below
# this: the largest change that was measured is 4e-14.
LEAST = 1e-9
# Processors that were not measured.
MARGIN = 100
# More than rounding can do: a decision between equal values fell otherwise, as for the highest of
# equal samples of an ADC. What it can change is bounded by the values there are to choose from.
DECISION = 1e-9
DECISION_MARGIN = 3
PERTURBATIONS = 30
BLAS_KERNELS = ("Prescott", "Haswell", "SkylakeX")
RUNS = """
import json
from tests.golden.runs import runs
print(json.dumps(runs()))
"""


def flat(figures: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each figure of nested tables and lists with its name, such as "clock.offset_ms"."""
    if isinstance(figures, dict | list):
        items = figures.items() if isinstance(figures, dict) else enumerate(figures)
        for key, value in items:
            yield from flat(value, f"{name}.{key}" if name else str(key))
        # An empty table is a figure too.
        yield f"{name}()", type(figures)
    else:
        yield name, figures


def tolerance(sensitivity: float) -> float:
    """Return the relative tolerance of a figure by its largest relative change."""
    if sensitivity > DECISION:
        return DECISION_MARGIN * sensitivity
    return max(LEAST, MARGIN * sensitivity)


def changes(now: Any, golden: Any) -> dict[str, float]:
    """Return the relative change of each figure that is not the same; infinite if not a number's.

    Only fractions may change: a count, a text and a list's length are the same or infinitely far.
    """
    new, old = dict(flat(now)), dict(flat(golden))
    changed = {}
    for name in new.keys() | old.keys():
        one, other = new.get(name), old.get(name)
        if type(one) is float and type(other) is float and other:
            change = abs(one / other - 1)
        else:
            change = 0.0 if type(one) is type(other) and one == other else float("inf")
        if change:
            changed[name] = change
    return changed


def differences(now: Any, golden: Any, sensitivity: dict[str, float]) -> dict[str, float]:
    """Return the relative changes that are beyond their tolerances."""
    return {
        name: change
        for name, change in changes(now, golden).items()
        if not change <= tolerance(sensitivity.get(name, 0.0))
    }


def measure(golden: dict[str, Any]) -> dict[str, dict[str, float]]:
    """Return the largest relative change of each figure by rounding, by scene."""
    found: dict[str, dict[str, float]] = {scene: {} for scene in SCENES}
    for result in _rounded_runs():
        for scene in SCENES:
            for seed in SEEDS:
                run_name = f"{scene} {seed}"
                for name, change in changes(result[run_name], golden[run_name]).items():
                    found[scene][name] = max(change, found[scene].get(name, 0.0))
    return {
        scene: {name: float(f"{change:.1e}") for name, change in sorted(each.items())}
        for scene, each in found.items()
    }


def _rounded_runs() -> Iterator[dict[str, Any]]:
    # Only here: older versions of numpy, which run the tests, name it otherwise.
    from numpy._core._multiarray_umath import __cpu_dispatch__ as levels

    kernels = [{"OPENBLAS_CORETYPE": name} for name in BLAS_KERNELS]
    for kernel in ({"NPY_DISABLE_CPU_FEATURES": " ".join(levels)}, *kernels):
        ended = run_python("-c", RUNS, env=os.environ | kernel, timeout=None)
        yield json.loads(ended.stdout)
    for seed in range(PERTURBATIONS):
        with rounded_otherwise(seed):
            yield runs()
