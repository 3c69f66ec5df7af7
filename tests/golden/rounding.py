"""Sums that are rounded otherwise, as another processor or another numpy rounds them.

A processor's own instructions sum in another order, and a library of C computes curves by other
polynomials. IEEE 754 states each digit of + − × ÷ √, so those are the same everywhere.
"""

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import wraps
from typing import Any

import numpy as np

PACKAGES = ("protocol", "pulse_sensors", "sensing_node", "display_node", "telepulse")
ULP = np.finfo(np.float64).eps
# A multiplier that spreads the bits of a number (Steele et al. 2014: Fast splittable pseudorandom
# number generators).
MIX = np.uint64(0x9E3779B97F4A7C15)
PRODUCTS = {"matmul", "vecdot", "matvec", "vecmat"}
CURVES = {
    *(
        "exp",
        "expm1",
        "log",
        "log1p",
        "log2",
        "log10",
        "pow",
        "power",
        "hypot",
        "sin",
        "cos",
        "tan",
    ),
    *("sinh", "cosh", "tanh", "asin", "acos", "atan", "atan2", "arcsin", "arccos", "arctan"),
    *("arctan2", "erf", "gamma"),
}
FUNCTIONS = {"convolve", "correlate", "dot", "einsum", "interp", "solve", "inv", "lstsq", "eigvals"}


def _plain(value: Any) -> Any:
    return value.view(np.ndarray) if isinstance(value, Rounded) else value


class Rounded(np.ndarray):
    """An array whose sums and curves are rounded otherwise, and so are those of its results."""

    seed = 0

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: Any, out: Any = None, **options: Any
    ) -> Any:
        """Compute as numpy does; move what is a sum or a curve."""
        if out is not None:
            options["out"] = tuple(map(_plain, out))
        result = getattr(ufunc, method)(*map(_plain, inputs), **options)
        # Accumulated sums have one order everywhere.
        summed = ufunc is np.add and method in ("reduce", "reduceat")
        if summed or ufunc.__name__ in PRODUCTS | CURVES:
            result = moved(result)
        elif type(result) is np.ndarray:
            result = result.view(Rounded)
        if out is None:
            return result
        options["out"][0][...] = result
        return out[0]

    def __array_function__(self, func: Any, types: Any, args: Any, kwargs: Any) -> Any:
        """Compute as numpy does; move what is a sum."""
        result = super().__array_function__(func, types, args, kwargs)
        return moved(result) if func.__name__ in FUNCTIONS else result


def moved(values: Any) -> Any:
    """Return floats, each one ulp higher or lower or the same; return other values as they are.

    Equal values move alike, as a function's results for equal arguments do. Whole numbers stay the
    same, because their sums are exact in every order.
    """
    if not isinstance(values, np.ndarray | np.floating) or values.dtype != np.float64:
        return values
    plain = np.asarray(values)
    with np.errstate(over="ignore"):
        mixed = (plain.view(np.uint64) ^ np.uint64(Rounded.seed)) * MIX >> np.uint64(33)
    ulps = (mixed % np.uint64(3)).astype(float) - 1
    result = plain * (1 + ulps * (plain != np.rint(plain)) * ULP)
    return result.view(Rounded) if isinstance(values, np.ndarray) else values.dtype.type(result)


def _rounding(function: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(function)
    def call(*args: Any, **options: Any) -> Any:
        result = function(*args, **options)
        if function.__name__ in FUNCTIONS:
            return moved(result)
        is_array = type(result) is np.ndarray and result.dtype == np.float64
        return result.view(Rounded) if is_array else result

    return call


class _Numpy:
    """numpy with functions that return `Rounded` arrays."""

    def __init__(self, module: Any) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        found = getattr(self._module, name)
        if name == "linalg":
            return _Numpy(found)
        is_function = callable(found) and not isinstance(found, type | np.ufunc)
        return _rounding(found) if is_function else found


class _Math:
    """The module `math` with curves that are moved."""

    def __getattr__(self, name: str) -> Any:
        found = getattr(math, name)
        return _moving(found) if name in CURVES else found


def _moving(curve: Callable[..., float]) -> Callable[..., float]:
    return lambda *args: float(moved(np.float64(curve(*args))))


@contextmanager
def rounded_otherwise(seed: int) -> Iterator[None]:
    """Let the modules of the product round their sums and curves otherwise."""
    Rounded.seed = seed
    ours = [module for name, module in sys.modules.items() if name.split(".")[0] in PACKAGES]
    altered = {"np": (np, _Numpy(np)), "math": (math, _Math())}
    used = [
        (vars(m), name) for m in ours for name in altered if vars(m).get(name) is altered[name][0]
    ]
    for names, name in used:
        names[name] = altered[name][1]
    try:
        yield
    finally:
        for names, name in used:
            names[name] = altered[name][0]
