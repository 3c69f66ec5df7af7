"""A class name stands for one kind of thing in the whole product."""

import ast
from collections import Counter

from tests.unit.test_import_cycles import product_modules

# Names that several classes may have: the same kind of thing behind one protocol.
SHARED: frozenset[str] = frozenset()


def test_no_two_classes_of_the_product_have_one_name() -> None:
    names = Counter(
        node.name
        for tree in product_modules().values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    )
    assert len(names) > 300
    assert {name for name, count in names.items() if count > 1} == SHARED
