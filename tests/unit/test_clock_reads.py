"""Which clock the product reads."""

import ast

from tests.unit.test_class_names import product_modules


def test_times_in_nanoseconds_are_read_by_the_fine_clock() -> None:
    # On Windows before Python 3.13, time.monotonic_ns has steps of 15.6 ms (decision 3).
    coarse = [
        name
        for name, tree in product_modules().items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and node.attr == "monotonic_ns"
    ]
    assert coarse == []
