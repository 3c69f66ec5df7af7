"""The two nodes as real processes, for tests."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import PIPE, CompletedProcess
from typing import Any, TypeVar

from protocol.host.child_process import ChildProcess
from protocol.host.output import OUR_LOGGERS
from telepulse.processes import free_addresses

ROOT = Path(__file__).parents[2]
RADIAL = ROOT / "scenes" / "radial.toml"
# The product, as it is installed.
PACKAGES = tuple(name for name in OUR_LOGGERS if name != "__main__")
Figure = TypeVar("Figure")


def free_address() -> str:
    """Return a loopback address whose port and the next one are free."""
    return free_addresses(1)[0]


def start(module: str, *arguments: str, **options: Any) -> ChildProcess:
    """Start a module of ours as a process; its output is piped."""
    usual: dict[str, Any] = {"cwd": ROOT, "stdout": PIPE, "stderr": PIPE}
    return ChildProcess(module, "-m", module, *arguments, **usual | options)


@contextmanager
def process(module: str, *arguments: str, **options: Any) -> Iterator[ChildProcess]:
    """Run a module until the end of the `with`; pytest shows its output if the test fails."""
    child = start(module, *arguments, **options)
    try:
        yield child
    finally:
        if child.poll() is None:
            child.kill()
        for output in child.communicate():
            print(module, output)


def run(module: str, *arguments: str, timeout_s: float = 60) -> "CompletedProcess[str]":
    """Run a module of ours to its end."""
    return run_python("-m", module, *arguments, timeout=timeout_s)


def run_python(
    *arguments: str, input: str | None = None, timeout: float | None = 60, **options: Any
) -> "CompletedProcess[str]":
    """Run Python on a command line to its end; options: of `ChildProcess`."""
    usual: dict[str, Any] = {"cwd": ROOT, "stdin": PIPE, "stdout": PIPE, "stderr": PIPE}
    with ChildProcess("program", *arguments, **usual | options) as child:
        output, errors = child.communicate(input, timeout)
    return CompletedProcess(child.args, child.returncode, output, errors)


def read_json(path: Path) -> dict[str, Any]:
    """Read the summary that a node has written."""
    table: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return table


def known(figure: Figure | None) -> Figure:
    """Return a figure of a summary, which must be there."""
    assert figure is not None
    return figure


def assert_accounted(samples: dict[str, int]) -> None:
    """Check that sent = played + predicted + late + lost."""
    parts = ("played", "predicted", "late", "lost")
    assert samples["sent"] == sum(samples[part] for part in parts)
