"""Golden figures: simulated runs over a bad link, the paper's numbers, keys, metrics and schemas.

`python -m tests.golden` writes them again. Do that only after a deliberate change, and name the
change in the commit. `test_golden.py` compares the summaries of runs to the last digit, and the
keys, metrics and schemas; `tests/system/reports/test_paper_command.py` compares the paper's tables.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from protocol.config.scene_file import find_scene
from protocol.wire.telemetry import Status
from telepulse.cli.study import build_paper
from telepulse.metrics.server import NodeState, families
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import summarise
from telepulse.telemetry.schema import SCHEMAS
from tests.support.full_summary import full_summary

FOLDER = Path(__file__).parent
NUMBER = re.compile(r"[−-]?\d+(?:\.\d+)?(?:e[−-]?\d+)?")
# Smaller figures are rounding errors, which differ between processors.
ROUNDING = 1e-10
SCENES = ("radial", "wan", "conditioned")
SEEDS = (1, 2)
LINK = "delay=40ms,jitter=10ms,loss=1%"
SECONDS = 20.0


def read(name: str) -> dict[str, Any]:
    """Return the stored "summaries" (by scene and seed), "paper" (by table) or "figures"."""
    stored: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return stored


def write(name: str, values: dict[str, Any], sort: bool = False) -> None:
    """Store what `read` returns."""
    text = json.dumps(values, indent=1, sort_keys=sort, ensure_ascii=False)
    (FOLDER / f"{name}.json").write_text(text + "\n", encoding="utf-8")


def run(scene: str, seed: int) -> dict[str, Any]:
    """Return a run's summary as JSON has it, without its speed and its windows of time.

    The predictor is one that does not learn, because linear algebra rounds differently on other
    processors.
    """
    loaded = load_scene(find_scene(scene), {"predictor": "linear"})
    loaded = replace(loaded, link=parse_link(LINK))
    summary: dict[str, Any] = json.loads(json.dumps(summarise(loaded, SECONDS, seed).to_dict()))
    del summary["speed"], summary["windows"]
    return summary


def paper_numbers(report: dict[str, Any]) -> dict[str, list[str]]:
    """Return the numbers in each row of the tables of `telepulse paper --json`, by table.

    The numbers are as printed, without the words around them, so that words may change.
    """
    return {
        f"chapter {chapter_number}, table {table_number}": [
            " ".join(_numbers(list(row.values()))) for row in table["rows"]
        ]
        for chapter_number, chapter in enumerate(report["chapters"], 1)
        for table_number, table in enumerate(chapter["tables"], 1)
    }


def _numbers(cells: list[str]) -> list[str]:
    found = [number for cell in cells for number in NUMBER.findall(cell)]
    return [
        "~0" if 0 < abs(float(number.replace("−", "-"))) < ROUNDING else number for number in found
    ]


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
    write("summaries", {f"{s} {n}": run(s, n) for s in SCENES for n in SEEDS}, sort=True)
    write("figures", figures())
