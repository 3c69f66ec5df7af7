from pathlib import Path

import pytest
from typer.testing import CliRunner

from protocol.config.scene_file import find_scene
from telepulse.cli.main import app
from telepulse.commissioning.tuning import (
    LEAST_DELAY_TICKS,
    MOST_SENSITIVITY,
    as_toml,
    design,
    judge,
)
from telepulse.scene import load_scene
from tests.support.nodes import ROOT, known

SCENES = ("radial", "wan", "bench", "real_bench", "conditioned")


def tune(scene: str | Path, *options: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["tune", str(scene), *options])
    return result.exit_code, result.stdout, result.stderr


@pytest.mark.parametrize("name", [*SCENES, "paper"])
def test_a_design_keeps_its_margins_and_gives_the_scenes_gains(name: str) -> None:
    display = load_scene(find_scene(name)).display
    found = design(display)
    worst = found.worst
    assert worst.stable
    assert worst.peak_sensitivity <= MOST_SENSITIVITY * 1.01
    assert worst.delay_s >= LEAST_DELAY_TICKS * display.tick_ns * 1e-9 * 0.99
    if name != "paper":
        assert found.controller == display.controller
        return
    # The paper's own gains have less margin than the design.
    present = judge(display, display.controller).worst
    assert present.peak_sensitivity > worst.peak_sensitivity
    assert present.delay_s < worst.delay_s


def test_the_design_is_the_best_within_its_margins() -> None:
    display = load_scene(find_scene("real_bench")).display
    best = design(display)
    timid, less, bolder = (
        judge(display, best.controller.model_copy(update={"kp": best.controller.kp * factor}))
        for factor in (0.5, 0.9, 1.1)
    )
    assert min(known(timid.felt_n), known(less.felt_n)) > known(best.felt_n)
    assert bolder.worst.peak_sensitivity > MOST_SENSITIVITY


def test_printed_gains_can_be_pasted_into_the_scene(tmp_path: Path) -> None:
    text = (ROOT / "scenes" / "real_bench.toml").read_text(encoding="utf-8")
    begin, end = text.index("[display.controller]"), text.index("[display.actuator]")
    proposed = design(load_scene(find_scene("real_bench")).display).controller
    scene = tmp_path / "tuned.toml"
    scene.write_text(text[:begin] + as_toml(proposed) + "\n\n" + text[end:], encoding="utf-8")
    assert load_scene(scene).display.controller == proposed
    status, out, _ = tune(scene)
    assert status == 0
    assert as_toml(proposed) in out


def test_a_loop_that_is_not_stable_is_refused_with_a_way_out(tmp_path: Path) -> None:
    text = (ROOT / "scenes" / "real_bench.toml").read_text(encoding="utf-8")
    begin, end = text.index("[display.controller.observer]"), text.index("[display.actuator]")
    scene = tmp_path / "wild.toml"
    scene.write_text(text[:begin].replace("kp = 190", "kp = 5000") + text[end:], encoding="utf-8")
    status, out, error = tune(scene)
    assert status == 2
    assert "[display.controller.observer]" in out
    assert error.count("\n") == 1
    assert "wild.toml" in error
    assert "not stable" in error
