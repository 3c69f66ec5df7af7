"""Deadline misses in virtual time: when they are an alarm, and when they are not."""

from display_node.scoring.deadlines import GAP_NS, WINDOW_NS, DeadlineWatch, deadline_alarm
from protocol.run_summary import Summary
from protocol.summary_tables import Loop

TICK_NS = 1_000_000


class Loops:
    """A loop in virtual time: `run` ticks on time, `late` begins a tick some periods late."""

    def __init__(self) -> None:
        self.watch = DeadlineWatch(TICK_NS)
        self.now_ns = 0

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e9) // TICK_NS):
            self.late(1)

    def late(self, elapsed_ticks: int) -> None:
        self.now_ns += elapsed_ticks * TICK_NS
        self.watch.add(self.now_ns, elapsed_ticks)


def test_single_misses_are_no_alarm() -> None:
    loops = Loops()
    for _ in range(100):
        loops.run(0.2)
        loops.late(2)
        assert not loops.watch.alarm
    assert loops.watch.worst_5s.missed == 0.005
    assert loops.watch.worst_5s.gap_ms == 2


def test_more_than_one_percent_of_five_seconds_is_an_alarm() -> None:
    loops = Loops()
    for missed in range(1, 52):
        loops.late(2)
        assert loops.watch.alarm == (missed > 50)
    # It stays on while the rate is about the bar, so that it is one alarm and not many.
    for _ in range(60):
        loops.run(0.1)
        loops.late(2)
        assert loops.watch.alarm
    loops.run(5)
    assert not loops.watch.alarm
    assert loops.watch.last_5s.missed == 0


def test_a_gap_above_the_watchdog_is_an_alarm_for_five_seconds() -> None:
    loops = Loops()
    loops.run(1)
    loops.late(GAP_NS // TICK_NS)
    assert not loops.watch.alarm
    loops.run(6)
    loops.late(GAP_NS // TICK_NS + 1)
    assert loops.watch.alarm
    assert loops.watch.last_5s.gap_ms == 51
    loops.run(WINDOW_NS * 1e-9 - 0.01)
    assert loops.watch.alarm
    loops.run(0.02)
    assert not loops.watch.alarm
    assert loops.watch.last_5s.gap_ms == 1
    assert loops.watch.worst_5s.gap_ms == 51


def test_the_alarm_names_the_share_and_the_gap() -> None:
    loops = Loops()
    loops.late(413)
    watch = loops.watch
    loop = Loop(1, 412, late=watch.alarm, last_5s=watch.last_5s, worst_5s=watch.worst_5s)
    text = deadline_alarm(Summary(loop=loop).to_dict()["loop"])
    assert text == "8.2 % of the ticks of the last 5 s missed, longest gap 413 ms"
    assert deadline_alarm({"ticks": 1, "late": False}) is None
    bare = "too many of the ticks of the last 5 s missed"
    assert deadline_alarm({"late": True}) == bare
    assert deadline_alarm(Summary(loop=Loop(late=True)).to_dict()["loop"]) == bare
    assert deadline_alarm({"ticks": 1}) is None
