import math
from typing import Any, cast

from telepulse.lsl_outlet import LslForwarder, LslStreams
from telepulse.telemetry.decoder import Entry
from telepulse.telemetry.schema import STATUS, TICK


class KeptStreams:
    """Outlets that keep what is pushed to the finger's stream."""

    def __init__(self) -> None:
        self.pushed: list[tuple[list[str], list[list[float]]]] = []

    def local_clock(self) -> float:
        return 0.0

    def push_event(self, text: str, time_s: float) -> None:
        pass

    def push_finger(
        self, contactors: list[str], forces_n: Any, times_s: list[float], pressed: bool
    ) -> None:
        assert len(times_s) == len(forces_n)
        self.pressed = pressed
        self.pushed.append((list(contactors), forces_n))


def finger_tick(*forces_n: tuple[float, float]) -> Entry:
    states = [{"target_n": target_n, "felt_n": felt_n} for target_n, felt_n in forces_n]
    first, *others = states
    more = {"others": others} if others else {}
    return Entry(TICK, 0, {"instant_ns": 0} | first | more)


def test_the_finger_stream_has_the_forces_of_each_contactor_by_name() -> None:
    outlets = KeptStreams()
    forwarder = LslForwarder(cast(LslStreams, outlets))
    forwarder.take([finger_tick((0.1, 0.2))])
    assert outlets.pushed.pop() == ([""], [[0.1, 0.2]])
    # Without a status, the contactors have no names.
    forwarder.take([finger_tick((0.1, 0.2), (0.3, 0.4))])
    assert outlets.pushed == []
    forwarder.take([Entry(STATUS, 0, {"summary": {"contactors": {"cun": {}, "chi": {}}}})])
    assert outlets.pushed.pop() == (["cun", "chi"], [[0.1, 0.2, 0.3, 0.4]])
    forwarder.take([finger_tick((0.5, 0.6), (0.7, 0.8))])
    assert outlets.pushed.pop() == (["cun", "chi"], [[0.5, 0.6, 0.7, 0.8]])
    forwarder.take([finger_tick((0.5, 0.6))])
    forwarder.finish()
    assert outlets.pushed == []
    assert forwarder.passed == {"ticks": 3, "ticks without names": 1}


def test_the_finger_stream_has_press_and_hold_down_where_the_finger_presses_back() -> None:
    outlets = KeptStreams()
    forwarder = LslForwarder(cast(LslStreams, outlets))
    before, after = finger_tick((1.1, 1.2)), finger_tick((1.3, 1.4))
    before.fields["press_n"] = 1.0
    after.fields.update(press_n=1.1, hold_down_n=0.9)
    forwarder.take([before, after])
    contactors, rows = outlets.pushed.pop()
    assert outlets.pressed
    assert contactors == [""]
    assert rows[0][:3] == [1.1, 1.2, 1.0]
    assert math.isnan(rows[0][3])
    assert rows[1] == [1.3, 1.4, 1.1, 0.9]
    forwarder.take([finger_tick((0.1, 0.2))])
    assert not outlets.pressed
