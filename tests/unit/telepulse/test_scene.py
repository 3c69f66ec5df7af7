from pathlib import Path

import pytest

from protocol.errors import SceneError
from telepulse.scene import load_scene
from telepulse.simulation.link_scene import LinkScene
from tests.support.nodes import RADIAL


def test_a_scene_without_a_link_has_a_link_without_impairments() -> None:
    assert load_scene(RADIAL).link == LinkScene()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('lead = "2 mm"', 'laed = "2 mm"', ["[display]", "actuator", "laed", "unknown key"]),
        ('lead = "2 mm"', 'lead = "2 N"', ["[display]", "actuator", "lead", "length"]),
        ('kind = "stepper"', 'kind = "steper"', ["[display]", "actuator", "stepper"]),
        ("[display]", "[displya]", ["displya", "did you mean display?"]),
        ("poisson_ratio = 0.5", "poisson_ratio = 0.6", ["poisson_ratio", "0.5"]),
        ("[display]\n", '[display]\npaths = "auto"\n', ["[display] paths", "write paths = 3"]),
    ],
)
def test_a_bad_scene_is_one_line_with_file_section_and_key(
    old: str, new: str, words: list[str], tmp_path: Path
) -> None:
    path = tmp_path / "bad.toml"
    text = RADIAL.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        load_scene(path)
    line = str(caught.value)
    assert "\n" not in line
    for word in (str(path), *words):
        assert word in line
