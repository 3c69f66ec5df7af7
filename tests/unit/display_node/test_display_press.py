"""A display whose finger presses, in virtual time: scene press over a link."""

from dataclasses import replace

import pytest

from display_node.scene import DisplayScene
from protocol.config.scene import validate
from protocol.config.scene_file import find_scene
from protocol.errors import SceneError
from protocol.wire.messages import ProbeReport, encode_control
from sensing_node.scene import SensingScene
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation


def scene(link: str = "delay=20ms,jitter=2ms,loss=1%") -> Scene:
    return replace(load_scene(find_scene("press")), link=parse_link(link))


def test_the_finger_feels_its_press_and_the_pulse_on_it() -> None:
    run = Simulation(scene(), 1)
    run.begin(6.0)
    forces = []
    for number in range(1, 6_000):
        state = run.tick(number * 1_000_000)
        if number > 5_000:
            forces.append(state.felt_n)
    # The first step is over; the finger presses with 1.2 N.
    assert 1.0 < min(forces) < 1.2 < max(forces) < 1.6


def test_a_report_without_a_press_or_of_another_session_is_refused() -> None:
    report = encode_control(ProbeReport(99, 0, 1, 1, 0, 0, "pressing", 1.0, 1e-3))
    plain = Simulation(replace(load_scene(find_scene("radial")), link=parse_link("delay=1ms")), 1)
    pressed = Simulation(scene(), 1)
    for run, cause in ((plain, "unexpected"), (pressed, "session")):
        run.begin(1.0)
        for number in range(1, 1_000):
            run.tick(number * 1_000_000)
        run.display.on_control(report, 1_000_000_000)
        assert run.display.receiver.rejected[cause] == 1


def test_nothing_is_sent_before_the_pulse_is_felt_or_after_a_fault() -> None:
    run = Simulation(scene("delay=1ms"), 1)
    run.begin(6.0)
    display, last, sent_at_ns = run.display, 0, []
    assert display.press is not None
    for number in range(1, 4_000):
        state = run.tick(number * 1_000_000)
        sent = display.press.figures().sent or 0
        if sent > last:
            sent_at_ns.append(state.now_ns)
        last = sent
        if number == 3_000:
            display.safety.fault("a fault")
    # The stream begins after 0.5 s, and is felt after a ramp.
    assert min(sent_at_ns) > 800_000_000
    # A finger that was blind for 0.3 s sends nothing.
    assert 3_000_000_000 < max(sent_at_ns) <= 3_310_000_000


@pytest.mark.parametrize(
    ("schema", "table", "reason"),
    [
        (
            SensingScene,
            {"source": {"kind": "wrist"}},
            r"pressed by a probe: add \[sensing.press\]",
        ),
        (
            SensingScene,
            {"source": {"kind": "synthetic"}, "press": {}},
            'press needs a source of kind "wrist"',
        ),
        (
            SensingScene,
            {
                "source": {"kind": "wrist"},
                "press": {},
                "conditioning": {"mains": "50 Hz"},
            },
            "leave it out for a wrist",
        ),
    ],
)
def test_a_press_without_what_it_needs_is_refused(
    schema: type[SensingScene] | type[DisplayScene], table: dict[str, object], reason: str
) -> None:
    with pytest.raises(SceneError, match=reason):
        validate(table, schema, "scene")
