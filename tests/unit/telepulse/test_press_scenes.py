"""The scenes of the press are the variants that `make bench ARGS=press` judges over TCP."""

import pytest

from telepulse.scene import load_scene
from tests.support.nodes import ROOT


@pytest.mark.parametrize(
    ("name", "batch_ms", "paths"),
    [("press", 5, 1), ("press_far", 50, 8)],
)
def test_a_scene_is_the_variant_that_is_judged(name: str, batch_ms: int, paths: int) -> None:
    scene = load_scene(ROOT / "scenes" / f"{name}.toml")
    press = scene.display.press
    assert press is not None
    assert press.connections == 16
    assert scene.sensing.batch_ns == batch_ms * 1_000_000
    assert (scene.display.paths or 1) == paths
