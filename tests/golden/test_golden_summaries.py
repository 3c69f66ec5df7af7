"""Simulated runs give the figures that they gave before, to the last digit."""

import pytest

from tests.golden.__main__ import SCENES, SEEDS, read, run


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("scene", SCENES)
def test_a_simulated_run_gives_the_same_figures_as_before(scene: str, seed: int) -> None:
    assert run(scene, seed) == read()[f"{scene} {seed}"]
