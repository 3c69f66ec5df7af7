import re
from pathlib import Path

import pytest

from protocol.host.child_process import python_command

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
