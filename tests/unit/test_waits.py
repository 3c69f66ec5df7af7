"""What the product waits with."""

import ast

from tests.unit.test_class_names import product_modules

# The one module that knows which call takes which descriptors, and on which system.
WAITS = "protocol/host/descriptors.py"


def test_no_other_module_waits_with_select() -> None:
    importing = [
        name
        for name, tree in product_modules().items()
        for node in ast.walk(tree)
        if (isinstance(node, ast.Import) and "select" in [each.name for each in node.names])
        or (isinstance(node, ast.ImportFrom) and node.module in ("select", "selectors"))
    ]
    assert importing == [WAITS]
