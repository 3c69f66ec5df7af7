"""Golden figures: simulated runs over a bad link, the paper's numbers, keys, metrics and schemas.

`python -m tests.golden` writes them again. Do that only after a deliberate change, and name the
change in the commit. `test_golden.py` compares the summaries of runs, and the keys, metrics and
schemas; `tests/system/paper/test_paper_command.py` compares the paper's tables.
"""

import json
import re
from pathlib import Path
from typing import Any

from protocol.wire.telemetry import Status
from telepulse.metrics.server import NodeState, families
from telepulse.paper.report import build_paper
from telepulse.telemetry.schema import SCHEMAS
from tests.golden.runs import runs
from tests.support.full_summary import full_summary

FOLDER = Path(__file__).parent
NUMBER = re.compile(r"[−-]?\d+(?:\.\d+)?(?:e[−-]?\d+)?")
# Smaller figures are rounding errors, which differ between processors and may be 0.
ROUNDING = 1e-10


def read(name: str) -> dict[str, Any]:
    """Return the stored "summaries" (by scene and seed), "paper" (by table) or "figures"."""
    stored: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return stored


def write(name: str, values: dict[str, Any], sort: bool = False) -> None:
    """Store what `read` returns."""
    text = json.dumps(values, indent=1, sort_keys=sort, ensure_ascii=False)
    (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def paper_numbers(report: dict[str, Any]) -> dict[str, list[str]]:
    """Return the numbers in each paragraph and row of a table of `telepulse paper --json`.

    The numbers are as printed, without the words around them, so that words may change. They are
    printed to few digits, which no processor changes.
    """
    numbers = {"findings": [" ".join(_numbers([each])) for each in report["findings"]]}
    for number, chapter in enumerate(report["chapters"], 1):
        numbers[f"chapter {number}"] = [
            " ".join(_numbers([each])) for each in chapter["paragraphs"]
        ]
        for table_number, table in enumerate(chapter["tables"], 1):
            numbers[f"chapter {number}, table {table_number}"] = [
                " ".join(_numbers(list(row.values()))) for row in table["rows"]
            ]
    return numbers


def _numbers(cells: list[str]) -> list[str]:
    found = [number for cell in cells for number in NUMBER.findall(cell)]
    return ["0" if abs(float(each.replace("−", "-"))) < ROUNDING else each for each in found]


def figures() -> dict[str, Any]:
    """Return a full summary, its Prometheus metrics, and the schemas of recordings."""
    summary = full_summary().to_dict()
    node = NodeState(Status("playing", "a stream", summary, False, 1), 0, [75.0])
    metrics = {
        f"{sample.name} {json.dumps(sample.labels, sort_keys=True)}": [metric.type, sample.value]
        for metric in families("display-node", node, 0)
        for sample in metric.samples
        if metric.name != "telepulse_node"
    }
    return {"summary": summary, "metrics": dict(sorted(metrics.items())), "schemas": SCHEMAS}


if __name__ == "__main__":
    write("paper", paper_numbers(build_paper().to_dict()))
    write("summaries", runs(), sort=True)
    write("figures", figures())
