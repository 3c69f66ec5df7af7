"""Checks of arguments that a program gives to a function of the package.

An argument that cannot be used raises ArgumentError: one line that names it.
"""

import math
import operator
import os
from collections.abc import Mapping
from numbers import Real
from pathlib import Path
from typing import Any

from protocol.config.quantities import shown
from protocol.errors import ArgumentError


def number(name: str, value: object, least: float, most: float) -> float:
    """Return a real number within its limits. Raises ArgumentError."""
    # A text such as "5" is no number, although `float` reads it.
    known = float(value) if isinstance(value, Real) else math.nan
    if not least <= known <= most:
        raise ArgumentError(f"{name}: must be a number from {least} to {most}, got {shown(value)}")
    return known


def whole_number(name: str, value: Any, least: int, most: int) -> int:
    """Return an integer of Python or numpy within its limits. Raises ArgumentError."""
    try:
        known = operator.index(value)
    except TypeError:
        known = None
    if known is None or not least <= known <= most:
        raise ArgumentError(
            f"{name}: must be a whole number from {least} to {most}, got {shown(value)}"
        )
    return known


def file_path(name: str, value: object) -> Path:
    """Return the path of a file from a path or a text. Raises ArgumentError."""
    if not isinstance(value, str | os.PathLike):
        raise ArgumentError(f"{name}: must be the path of a file, got {shown(value)}")
    return Path(value)


def table(name: str, value: object, example: str) -> Mapping[str, Any]:
    """Return a mapping of keys to values. Raises ArgumentError, with an example of what fits."""
    if not isinstance(value, Mapping):
        raise ArgumentError(f"{name}: must be a table such as {example}, got {shown(value)}")
    return value
