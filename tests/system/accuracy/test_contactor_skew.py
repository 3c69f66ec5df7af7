"""Contactors play one instant of the pulse: how far their forces are apart in time."""

from dataclasses import replace
from typing import Any

import pytest

from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from tests.support.contactor_lags import lags_ms
from tests.support.nodes import ROOT

MOST_SKEW_MS = 0.1
LINKS = ("delay=0ms", "delay=40ms,jitter=10ms,loss=1%")
# An actuator with a lag of its own, which its loop compensates.
SLOW: dict[str, Any] = {
    "actuator": {"kind": "stepper", "microsteps": 16, "lead": "2 mm", "latency": "5 ms"},
    "controller": {"error": "position", "kp": 30, "feed_forward": True},
}


def three_fingers(predictor: str, link: str = LINKS[1], **changes: Any) -> Scene:
    """Return the scene over a link, with changes of its second contactor."""
    scene = load_scene(ROOT / "scenes" / "three_fingers.toml", {"predictor": predictor})
    if changes:
        first, second, third = scene.display.contactor
        changed = type(second).model_validate({"channel": second.channel, **changes})
        display = scene.display.model_copy(update={"contactor": (first, changed, third)})
        scene = replace(scene, display=display)
    return replace(scene, link=parse_link(link))


def skew_ms(scene: Scene) -> float:
    found = lags_ms(scene, seconds=14, settle_seconds=8)
    return max(found) - min(found)


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("predictor", ["linear", "stack"])
def test_equal_contactors_are_at_most_a_tenth_of_a_millisecond_apart(
    predictor: str, link: str
) -> None:
    assert skew_ms(three_fingers(predictor, link)) < MOST_SKEW_MS


def test_a_slow_actuator_among_others_is_not_felt_later() -> None:
    scene = three_fingers("linear", **SLOW)
    # Between two ticks, the reference is interpolated: that may differ by some of a tick.
    most_ms = MOST_SKEW_MS * scene.display.tick_ns * 1e-6
    assert skew_ms(scene) < most_ms
