"""The scenes of the press are the variants that the study judges over TCP."""

import pytest

from telepulse.reports.studies.press_scores import LONG_FRAMES, SCENE_VARIANT, TcpVariant
from telepulse.scene import load_scene
from tests.support.nodes import ROOT


@pytest.mark.parametrize(
    ("name", "variant"), [("press", SCENE_VARIANT), ("press_far", LONG_FRAMES)]
)
def test_a_scene_is_the_variant_that_is_judged(name: str, variant: TcpVariant) -> None:
    scene = load_scene(ROOT / "scenes" / f"{name}.toml")
    press = scene.display.press
    assert press is not None
    assert press.connections == variant.connections
    assert scene.sensing.batch_ns == variant.batch * 1_000_000
    assert scene.display.paths == variant.paths
