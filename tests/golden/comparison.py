"""Comparison of figures with those of another machine."""

from collections.abc import Iterator
from typing import Any

# Largest relative change by rounding. A change of the product shows at a millionth of a figure;
# other processors, and other kernels of numpy and BLAS, change the last digits, up to 4e-14.
TOLERANCE = 1e-9


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


def differences(now: Any, golden: Any) -> dict[str, float]:
    """Return the relative change of each figure that is not the same but for rounding.

    Only fractions may be rounded: a count, a text and a list's length are the same or infinitely
    far.
    """
    new, old = dict(flat(now)), dict(flat(golden))
    changed = {}
    for name in new.keys() | old.keys():
        one, other = new.get(name), old.get(name)
        if type(one) is float and type(other) is float and other:
            change = abs(one / other - 1)
        else:
            change = 0.0 if type(one) is type(other) and one == other else float("inf")
        if not change <= TOLERANCE:
            changed[name] = change
    return changed
