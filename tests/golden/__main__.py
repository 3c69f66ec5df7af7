"""Golden summaries: three scenes and four seeds, simulated over a bad link.

`python -m tests.golden` writes them anew; do that only where an equation was meant to change, and
say so in the commit. `test_golden_summaries.py` compares a run with them to the last digit.
"""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from telepulse.scene import find_scene, load_scene
from telepulse.simulation.link_model import parse_link
from telepulse.simulation.virtual_time import simulate

FILE = Path(__file__).with_name("summaries.json")
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


if __name__ == "__main__":
    summaries = {f"{scene} {seed}": run(scene, seed) for scene in SCENES for seed in SEEDS}
    text = json.dumps(summaries, indent=1, sort_keys=True, ensure_ascii=False)
    FILE.write_text(text + "\n", encoding="utf-8")
