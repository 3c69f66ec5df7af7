"""A node that runs as a process of its own: how it ended, and what it summed up."""

import json
import subprocess
from pathlib import Path

from pydantic import TypeAdapter

from protocol.errors import TelepulseError
from protocol.summary import Summary

_SUMMARY = TypeAdapter(Summary)


class NodeError(TelepulseError, RuntimeError):
    """A node's process failed, or did not end."""


def await_end(
    process: subprocess.Popen[str], name: str, seconds: float, *, may_end_with: int = 0
) -> None:
    """Wait for a process to end well within `seconds`. Raises NodeError with its last line.

    may_end_with: a further exit status that is no failure of the process.
    """
    try:
        _, errors = process.communicate(timeout=seconds)
    except subprocess.TimeoutExpired:
        raise NodeError(f"the {name} did not end within {seconds:.0f} s") from None
    if process.returncode not in (0, may_end_with):
        last = errors.strip().splitlines()[-1:] or ["it said nothing"]
        raise NodeError(f"the {name} ended with status {process.returncode}: {last[0]}")


def read_summary(path: Path) -> Summary:
    """The summary that a node wrote with --json."""
    return _SUMMARY.validate_python(json.loads(path.read_text(encoding="utf-8")))
