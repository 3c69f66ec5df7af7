"""Figures, keys, metrics and schemas are the same as before."""

import json

import pytest

from tests.golden.__main__ import SCENES, SEEDS, figures, read, run


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("scene", SCENES)
def test_a_simulated_run_gives_the_same_figures_to_the_last_digit(scene: str, seed: int) -> None:
    assert run(scene, seed) == read("summaries")[f"{scene} {seed}"]


def test_keys_metrics_and_schemas_are_the_same() -> None:
    golden, now = read("figures"), json.loads(json.dumps(figures()))
    assert now == golden
    assert list(now["summary"]) == list(golden["summary"])
