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

    def push_finger(self, contactors: list[str], forces_n: Any, times_s: list[float]) -> None:
        assert len(times_s) == len(forces_n)
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
