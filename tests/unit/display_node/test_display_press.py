"""A display whose finger presses, in virtual time: scene press over a link."""

from dataclasses import replace

from protocol.config.scene_file import find_scene
from protocol.faults import Fault, FaultKind, Part
from protocol.wire.messages import ProbeReport, encode_control
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import parse_link
from telepulse.simulation.virtual_time import Simulation


def scene(link: str = "delay=20ms,jitter=2ms,loss=1%") -> Scene:
    return replace(load_scene(find_scene("press")), link=parse_link(link))


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
            display.fade.fault(Fault(FaultKind.UNPLUGGED, Part.DRIVE, "any"))
    # The stream begins after 0.5 s, and is felt after a ramp.
    assert min(sent_at_ns) > 800_000_000
    # A finger that was blind for 0.3 s sends nothing.
    assert 3_000_000_000 < max(sent_at_ns) <= 3_310_000_000
