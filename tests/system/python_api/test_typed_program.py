"""A type checker finds the typing errors of a program that uses the package."""

import re
from pathlib import Path

import pytest

from tests.support.nodes import run_python

RIGHT = """
import telepulse

run = telepulse.simulate("radial", seconds=5, link="delay=40ms")
print(run.felt_n.mean(), run.marks, telepulse.__version__.split("."))
print(telepulse.load_scene("radial").display.compensation_ns)
"""
WRONG = {
    'telepulse.simulat("radial", seconds=5)': 'no attribute "simulat"',
    'telepulse.simulate("radial", secnds=5)': 'Unexpected keyword argument "secnds"',
    "run.feltn": '"Run" has no attribute "feltn"',
    "telepulse.__version__ + 1": "Unsupported operand",
}


# Every module that the package imports is checked once, without a cache.
@pytest.mark.timeout(400)
def test_each_slip_of_a_program_is_found(tmp_path: Path) -> None:
    lines = RIGHT.splitlines()
    (tmp_path / "program.py").write_text("\n".join([*lines, *WRONG]) + "\n", encoding="utf-8")
    arguments = ("--strict", "--cache-dir", str(tmp_path / "cache"), "program.py")
    output = run_python("-m", "mypy", *arguments, cwd=tmp_path, timeout=None).stdout
    found = re.findall(r"^program\.py:(\d+): error: (.*)$", output, re.MULTILINE)
    assert [int(line) for line, _ in found] == [len(lines) + 1 + n for n in range(len(WRONG))], (
        output
    )
    for (_, text), part in zip(found, WRONG.values(), strict=True):
        assert part in text
