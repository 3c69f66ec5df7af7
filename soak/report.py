"""The verdict as a table, and as JSON."""

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from protocol.errors import OutputError
from soak.faults import Played, gaps_s, recoveries
from soak.processes import SoakProcess
from soak.run import Run
from soak.verdict import MEGA, Check

# A narrower table wraps its figures.
MIN_WIDTH = 140
_WORDS = {True: "ok", False: "FAILED", None: ""}


def print_verdict(run: Run, checks: Sequence[Check], console: Console) -> None:
    """Print all checks, and the result in one line."""
    table = Table(box=None, pad_edge=False)
    for column in ("check", "found", "bar", ""):
        table.add_column(column, overflow="fold")
    for check in checks:
        table.add_row(*map(Text, (check.name, check.found, check.bar, _WORDS[check.ok])))
    console.width = max(console.width, MIN_WIDTH)
    console.print(table)
    faults = _faults(run)
    judged = [check for check in checks if check.ok is not None]
    failed = [check.name for check in judged if not check.ok]
    console.print(
        f"{faults.total()} faults of {len(faults)} kinds done to {len(run.scenario.all_nodes)}"
        f" processes; {len(judged) - len(failed)} of {len(judged)} checks passed"
        + (f"; FAILED: {', '.join(failed)}" if failed else "")
    )


def write_verdict(run: Run, checks: Sequence[Check], minutes: float, path: Path) -> None:
    """Write the record of the soak as JSON. Raises OutputError."""
    table = {
        "minutes": minutes,
        "seed": run.seed,
        "passed": all(check.ok is not False for check in checks),
        "checks": [asdict(check) for check in checks],
        "felt_again_s": recoveries(run.played, run.taps.felt),
        "episodes": [_episode(run, played) for played in run.played],
        "processes": [_node(run, node) for node in run.scenario.all_nodes],
    }
    try:
        path.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from None


def _faults(run: Run) -> Counter[str]:
    return Counter(done.fault.kind for played in run.played for done in played.done)


def _episode(run: Run, played: Played) -> dict[str, Any]:
    """Return its faults, and the longest time without the pulse of each display."""
    faults = [
        {
            **asdict(done.fault),
            "began_s": (done.began_ns - run.began_ns) * 1e-9,
            "over_s": (done.over_ns - run.began_ns) * 1e-9,
        }
        for done in played.done
    ]
    gaps = {role: gaps_s([played], felt)[0] for role, felt in run.taps.felt.items()}
    return {"faults": faults, "longest_gap_s": gaps}


def _node(run: Run, node: SoakProcess) -> dict[str, Any]:
    """Return the end of a process, its resources over time, and its last summary."""
    return {
        "role": node.role,
        "began_s": (node.began_ns - run.began_ns) * 1e-9,
        "ending": node.ending,
        "status": node.process.returncode,
        "usage": {
            "at_s": [round((x.at_ns - run.began_ns) * 1e-9, 1) for x in node.usage],
            "memory_mb": [round(x.memory_bytes / MEGA, 3) for x in node.usage],
            "handles": [x.descriptors for x in node.usage],
            "threads": [x.threads for x in node.usage],
        },
        "summary": node.summary,
    }
