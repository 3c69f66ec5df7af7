"""Nothing in the product asks whether a table is of a certain kind: a plug-in's is none of them."""

import ast

from telepulse.plugins import GROUPS
from tests.unit.test_import_cycles import product_modules


def classes_asked_for(tree: ast.Module) -> set[str]:
    """Return the names of classes in `isinstance` and in `case`."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance":
            found |= {each.id for each in ast.walk(node.args[1]) if isinstance(each, ast.Name)}
        elif isinstance(node, ast.MatchClass):
            found |= {each.id for each in ast.walk(node.cls) if isinstance(each, ast.Name)}
    return found


def test_no_module_asks_for_a_kind() -> None:
    kinds = {each.__name__ for group in GROUPS for each in group.sections().values()}
    assert {"SyntheticScene", "StepperScene", "TmclScene", "OwnPredictorScene"} < kinds
    asking = {name: classes_asked_for(tree) & kinds for name, tree in product_modules().items()}
    assert {name: found for name, found in asking.items() if found} == {}


def test_own_kinds_can_be_used_and_are_listed_once() -> None:
    listed = [each for group in GROUPS for each in group.listed()]
    own = [(each.group, each.kind) for each in listed if each.distribution == "telepulse"]
    assert len(own) == len(set(own)) == sum(len(group.own) for group in GROUPS)
    assert [each for each in listed if each.problem] == []
