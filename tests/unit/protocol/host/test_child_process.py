import ast
import importlib.util
import re
from pathlib import Path

import pytest

from protocol.errors import SidecarError
from protocol.host.child_process import python_command, sidecar_module

ROOT = Path(__file__).parents[4]
PRODUCT = ("protocol", "pulse_sensors", "sensing_node", "display_node", "telepulse")
STARTS = re.compile(r"sys\.executable|\bPopen\(|\bos\.(?:exec|spawn|posix_spawn)")


def test_python_is_started_with_a_safe_path() -> None:
    assert python_command("-m", "telepulse")[1:] == ["-P", "-m", "telepulse"]


@pytest.mark.parametrize("package", PRODUCT)
def test_only_one_module_starts_processes_of_ours(package: str) -> None:
    found = [
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / package).rglob("*.py")
        if STARTS.search(path.read_text(encoding="utf-8"))
    ]
    assert found == (["protocol/host/child_process.py"] if package == "protocol" else [])


BELOW = ("protocol", "pulse_sensors", "sensing_node", "display_node")


@pytest.mark.parametrize("name", ["metrics", "recorder"])
def test_what_a_node_starts_beside_itself_is_an_installed_module(name: str) -> None:
    assert importlib.util.find_spec(sidecar_module(name)) is not None


def test_what_is_not_installed_is_refused_in_one_line() -> None:
    with pytest.raises(SidecarError, match=r"^no installed package provides 'oracle'; pip .*$"):
        sidecar_module("oracle")


@pytest.mark.parametrize("package", BELOW)
def test_nothing_of_telepulse_is_named_below_it(package: str) -> None:
    named = [
        f"{path.relative_to(ROOT)}: {text}"
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(text := node.value, str)
        if is_module(text)
    ]
    assert named == []


def test_a_module_of_telepulse_is_noticed() -> None:
    assert is_module("telepulse.metrics")
    assert is_module("telepulse.cli.record")
    assert not is_module("telepulse.sidecars")


def is_module(text: str) -> bool:
    parts = text.split(".")
    if parts[0] != "telepulse" or len(parts) == 1 or not all(map(str.isidentifier, parts)):
        return False
    path = ROOT.joinpath(*parts)
    return path.is_dir() or path.with_suffix(".py").exists()
