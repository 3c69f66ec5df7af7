"""No two modules of the product import each other, directly or through others.

Imports within functions and for type checking count: they too tie modules together.
"""

import ast
import re
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = (
    "protocol",
    "pulse_sensors",
    "pulse_drives",
    "sensing_node",
    "display_node",
    "telepulse",
)


def product_modules() -> dict[str, ast.Module]:
    modules = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            modules[name.removesuffix(".__init__")] = ast.parse(path.read_bytes())
    return modules


def imported(tree: ast.Module, known: set[str]) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            for alias in node.names:
                module = f"{node.module}.{alias.name}"
                names.add(module if module in known else node.module)
    return names & known


def test_only_their_own_tests_import_the_benchmarks() -> None:
    # By the runner, the documentation's test parses the commands of the pages.
    imports = re.compile(r"^\s*(?:from|import) benchmarks\b(?!\.__main__)", re.MULTILINE)
    own = ROOT / "tests/unit/benchmarks"
    tests = [path for path in (ROOT / "tests").rglob("*.py") if own not in path.parents]
    assert [path for path in tests if imports.search(path.read_text(encoding="utf-8"))] == []


def test_the_import_graph_has_no_cycle() -> None:
    modules = product_modules()
    graph = {name: imported(tree, set(modules)) for name, tree in modules.items()}
    assert len(graph) > 100
    assert sum(map(len, graph.values())) > 500
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        raise AssertionError("import cycle: " + " ← ".join(error.args[1])) from None
