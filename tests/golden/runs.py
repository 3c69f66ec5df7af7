"""Golden runs: scenes over a bad link, in virtual time."""

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from protocol.config.scene_file import find_scene
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation

SCENES = ("radial", "wan", "conditioned")
SEEDS = (1, 2)
LINK = "delay=40ms,jitter=10ms,loss=1%"
SECONDS = 20.0


def run(
    scene: str, seed: int, sensing: Mapping[str, Any] = {}, display: Mapping[str, Any] = {}
) -> dict[str, Any]:
    """Return a run's summary as JSON has it, without its speed and its windows of time.

    sensing, display: changes of the scene. The predictor is one that does not learn: a learnt one
    makes much of the rounding of its linear algebra.
    """
    changed = {"predictor": "linear", **display}
    loaded = load_scene(find_scene(scene), sensing=sensing, display=changed)
    loaded = replace(loaded, link=parse_link(LINK))
    summary: dict[str, Any] = json.loads(
        json.dumps(Simulation(loaded, seed).run(SECONDS).to_dict())
    )
    del summary["speed"], summary["windows"]
    return summary


def runs() -> dict[str, Any]:
    """Return the summaries of all golden runs, by scene and seed."""
    return {f"{scene} {seed}": run(scene, seed) for scene in SCENES for seed in SEEDS}
