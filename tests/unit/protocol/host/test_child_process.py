import ast
import importlib.util
import re
from pathlib import Path

import pytest

from protocol.errors import SidecarError
from protocol.host.child_process import python_command, sidecar_module

ROOT = Path(__file__).parents[4]
PRODUCT = ("protocol", "pulse_sensors", "pulse_drives", "sensing_node", "display_node", "telepulse")
STARTS = re.compile(
    r"sys\.executable|\bPopen\(|\bsubprocess\.(?:run|call|check_)"
    r"|\bos\.(?:exec|spawn|posix_spawn|system|popen)"
)
# The class itself, and modules that start other programs.
STARTERS = {
    "protocol/host/child_process.py": "Python, for all others",
    "protocol/provenance.py": "git",
    "tests/machines/__main__.py": "pytest",
    "tests/machines/environments.py": "Python, pip, git, and tools of the system",
    "tests/run_all.py": "pytest",
    "tests/support/routers.py": "ip, iptables, ssh, wg",
    "tests/system/compiled/test_installation.py": "make",
    "tests/system/containers/test_compose.py": "docker",
    "tests/system/discovery/test_discovery.py": "unshare",
    "tests/system/documentation/test_commands.py": "make",
    "tests/system/lsl/test_lab_recorder.py": "LabRecorder",
    "tests/system/metrics/test_prometheus.py": "prometheus, promtool",
    "tests/system/recording/test_recorder.py": "mount",
    "tests/system/sensors/test_firmware.py": "a compiler",
}


def test_python_is_started_with_a_safe_path() -> None:
    assert python_command("-m", "telepulse")[1:] == ["-P", "-m", "telepulse"]


def test_only_one_module_starts_processes_of_ours() -> None:
    found = {
        path.relative_to(ROOT).as_posix()
        for package in (*PRODUCT, "tests", "soak", "fuzz", "benchmarks")
        for path in (ROOT / package).rglob("*.py")
        if STARTS.search(path.read_text(encoding="utf-8"))
    }
    assert found == {*STARTERS}


@pytest.mark.parametrize("name", ["metrics", "recorder"])
def test_a_sidecar_is_an_installed_module(name: str) -> None:
    assert importlib.util.find_spec(sidecar_module(name)) is not None


def test_an_unknown_sidecar_is_refused_in_one_line() -> None:
    with pytest.raises(SidecarError, match=r"^no installed package provides 'oracle'; pip .*$"):
        sidecar_module("oracle")


@pytest.mark.parametrize("package", PRODUCT[:-1])
def test_no_lower_package_names_a_module_of_telepulse(package: str) -> None:
    named = [
        f"{path.relative_to(ROOT)}: {node.value}"
        for path in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and is_module(node.value)
    ]
    assert named == []


def test_a_module_of_telepulse_is_recognised() -> None:
    assert is_module("telepulse.metrics")
    assert is_module("telepulse.cli.record")
    assert not is_module("telepulse.sidecars")


def is_module(text: object) -> bool:
    if not isinstance(text, str) or re.fullmatch(r"telepulse(\.\w+)+", text) is None:
        return False
    path = ROOT.joinpath(*text.split("."))
    return path.is_dir() or path.with_suffix(".py").exists()
