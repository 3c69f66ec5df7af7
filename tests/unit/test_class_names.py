"""A class name stands for one kind of thing in the whole product."""

import ast
from collections import Counter

from tests.support.nodes import PACKAGES, ROOT

# Names that several classes may have: the same kind of thing behind one protocol.
SHARED: frozenset[str] = frozenset()


def product_modules() -> dict[str, ast.Module]:
    paths = (path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
    return {str(path.relative_to(ROOT)): ast.parse(path.read_bytes()) for path in paths}


def test_no_two_classes_of_the_product_have_one_name() -> None:
    names = Counter(
        node.name
        for tree in product_modules().values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    )
    assert len(names) > 300
    assert {name for name, count in names.items() if count > 1} == SHARED
