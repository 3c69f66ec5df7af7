"""`python -m fuzz`: its output for a target that holds, and for those that do not."""

import importlib.util
import os
import re
from pathlib import Path
from subprocess import CompletedProcess
from typing import Any

import pytest

from tests.support.nodes import ROOT, run_python

needs_atheris = pytest.mark.skipif(
    importlib.util.find_spec("atheris") is None,
    reason="atheris is not installed: there is no wheel of it for every Python; make fuzz",
)


def fuzz(*arguments: str, **options: Any) -> "CompletedProcess[str]":
    return run_python("-m", "fuzz", *arguments, timeout=110, **options)


@needs_atheris
def test_a_target_without_a_crash(tmp_path: Path) -> None:
    ended = fuzz("--only", "frame", "--seconds", "1", "--out", str(tmp_path))
    assert ended.returncode == 0, ended.stdout + ended.stderr
    row, verdict = ended.stdout.splitlines()[1:]
    found = re.fullmatch(r"frame +([\d,]+) +[\d,]+ +([\d,]+) +\d+ MB +0", row)
    assert found is not None
    inputs, features = (int(number.replace(",", "")) for number in found.groups())
    assert inputs > 10
    assert features > 10
    assert re.fullmatch(rf"ok: {found[1]} inputs on 1 targets in \d+ s, 0 crashes", verdict)
    assert list((tmp_path / "frame" / "corpus").iterdir())


# Decoders that stumble over a byte, take much memory for it, or make room and never use it.
BROKEN = {
    "AssertionError": 'assert b"\\x7f" not in data',
    "bytes took": 'b"x" * (200 << 20 if b"\\x7f" in data else 1)',
    "MemoryError": 'bytes(1 << 30 if b"\\x7f" in data else 1)',
}


@needs_atheris
@pytest.mark.parametrize(("reason", "code"), BROKEN.items(), ids=BROKEN)
def test_a_crash_is_reported_with_its_input(reason: str, code: str, tmp_path: Path) -> None:
    package = tmp_path / "fuzz"
    package.mkdir()
    for source in (ROOT / "fuzz").glob("*.py"):
        (package / source.name).write_text(source.read_text("utf-8"), "utf-8")
    (package / "targets").mkdir()
    (package / "targets" / "__init__.py").write_text('NAMES = ("broken",)\n', "utf-8")
    (package / "targets" / "broken.py").write_text(
        f"def seeds():\n    return [b'seed']\n\n\ndef try_one(data):\n    {code}\n", "utf-8"
    )
    paths = (str(tmp_path), os.environ.get("PYTHONPATH", ""))
    options: dict[str, Any] = {"cwd": tmp_path}
    options["env"] = os.environ | {"PYTHONPATH": os.pathsep.join(paths)}
    ended = fuzz("--seconds", "30", "--out", "out", **options)
    assert ended.returncode == 1, ended.stdout + ended.stderr
    assert re.search(r"^FAIL: [\d,]+ inputs on 1 targets in \d+ s, 1 crashes$", ended.stdout, re.M)
    assert reason in ended.stdout
    crash = re.search(r"^input: ([0-9a-f]+)$", ended.stdout, re.M)
    assert crash is not None
    assert b"\x7f" in bytes.fromhex(crash[1])
    again = re.search(r"^again: (.+)$", ended.stdout, re.M)
    assert again is not None
    assert run_python(*again[1].split()[1:], **options).returncode != 0


def test_an_unknown_target_is_refused() -> None:
    ended = fuzz("--only", "nothing")
    assert ended.returncode == 2
    assert ended.stderr.startswith("fuzz: no target nothing; known: binary_frames, ")
