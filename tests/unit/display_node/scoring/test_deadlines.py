"""Alarms on missed ticks, in virtual time."""

from display_node.scoring.deadlines import GAP_NS, WINDOW_NS, DeadlineWatch

TICK_NS = 1_000_000


class VirtualLoop:
    """Loop in virtual time: `run` begins ticks on time, `late` one tick some periods late."""

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
    loop = VirtualLoop()
    for _ in range(100):
        loop.run(0.2)
        loop.late(2)
        assert not loop.watch.alarm
    assert loop.watch.worst_5s.missed == 0.005
    assert loop.watch.worst_5s.gap_ms == 2


def test_more_than_one_percent_of_five_seconds_is_an_alarm() -> None:
    loop = VirtualLoop()
    for missed in range(1, 52):
        loop.late(2)
        assert loop.watch.alarm == (missed > 50)
    # Hysteresis: the alarm stays on while the share is near 1 %.
    for _ in range(60):
        loop.run(0.1)
        loop.late(2)
        assert loop.watch.alarm
    loop.run(5)
    assert not loop.watch.alarm
    assert loop.watch.last_5s.missed == 0


def test_a_gap_above_the_watchdog_is_an_alarm_for_five_seconds() -> None:
    loop = VirtualLoop()
    loop.run(1)
    loop.late(GAP_NS // TICK_NS)
    assert not loop.watch.alarm
    loop.run(6)
    loop.late(GAP_NS // TICK_NS + 1)
    assert loop.watch.alarm
    assert loop.watch.last_5s.gap_ms == 51
    loop.run(WINDOW_NS * 1e-9 - 0.01)
    assert loop.watch.alarm
    loop.run(0.02)
    assert not loop.watch.alarm
    assert loop.watch.last_5s.gap_ms == 1
    assert loop.watch.worst_5s.gap_ms == 51
