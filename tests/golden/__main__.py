"""Golden figures: three scenes and four seeds over a bad link, and the numbers of the paper.

`python -m tests.golden` writes them anew; do that only where an equation was meant to change, and
say so in the commit. `test_golden_summaries.py` compares a run with the summaries, and
`tests/system/reports/test_paper_command.py` the command's tables with the paper's numbers, both to
the last digit.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from protocol.config.scene_file import find_scene
from telepulse.cli.study import build_paper
from telepulse.scene import load_scene
from telepulse.simulation.link_model import parse_link
from telepulse.simulation.virtual_time import simulate

FILE = Path(__file__).with_name("summaries.json")
PAPER_FILE = FILE.with_name("paper.json")
NUMBER = re.compile(r"[−-]?\d+(?:\.\d+)?(?:e[−-]?\d+)?")
# Smaller figures are rounding errors, which another processor makes otherwise.
ROUNDING = 1e-10
SCENES = ("radial", "wan", "conditioned")
SEEDS = (1, 2, 3, 4)
LINK = "delay=40ms,jitter=10ms,loss=1%"
SECONDS = 20.0


def read() -> dict[str, Any]:
    """Return the stored summaries by "scene seed"."""
    summaries: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return summaries


def run(scene: str, seed: int) -> dict[str, Any]:
    """Return a run's summary as JSON has it, without its speed."""
    loaded = replace(load_scene(find_scene(scene)), link=parse_link(LINK))
    summary: dict[str, Any] = json.loads(json.dumps(simulate(loaded, SECONDS, seed).to_dict()))
    del summary["speed"]
    return summary


def paper_numbers(report: dict[str, Any]) -> dict[str, list[str]]:
    """Return the numbers in each row of the tables of `telepulse paper --json`, by table.

    The numbers are as printed, without the words around them, so that words may be mended.
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


def read_paper_numbers() -> dict[str, list[str]]:
    """Return the stored numbers of the paper's tables."""
    numbers: dict[str, list[str]] = json.loads(PAPER_FILE.read_text(encoding="utf-8"))
    return numbers


if __name__ == "__main__":
    numbers = paper_numbers(build_paper().to_dict())
    PAPER_FILE.write_text(
        json.dumps(numbers, indent=1, ensure_ascii=False) + "\n", encoding="utf-8"
    )
    summaries = {f"{scene} {seed}": run(scene, seed) for scene in SCENES for seed in SEEDS}
    text = json.dumps(summaries, indent=1, sort_keys=True, ensure_ascii=False)
    FILE.write_text(text + "\n", encoding="utf-8")
