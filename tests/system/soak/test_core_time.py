import os
from dataclasses import replace
from subprocess import PIPE

import pytest

from protocol.host.child_process import ChildProcess
from soak.core_time import CoreTime, Excused, excuse, read_core_time
from soak.verdict import LoopFigures, judge_calm_loop
from tests.support.waiting import PATIENCE_S, until

MS = 1_000_000


def reading(at_ms: int, waited_ms: float, stolen_ms: int = 0, processor: int = 0) -> CoreTime:
    return CoreTime(at_ms * MS, round(waited_ms * MS), processor, stolen_ms * MS)


def excused(misses: list[tuple[int, int, int]], *readings: CoreTime) -> Excused:
    return excuse([(a * MS, b * MS, missed) for a, b, missed in misses], readings, MS)


def test_a_miss_is_excused_by_as_much_as_the_loop_waited_meanwhile() -> None:
    before, after = reading(0, 5.0), reading(20, 8.2)
    assert excused([(4, 9, 4)], before, after) == Excused(waited=3)
    assert excused([(4, 6, 1)], before, after) == Excused(waited=1)
    # Two gaps between the same readings share it.
    assert excused([(4, 7, 2), (10, 13, 2)], before, after) == Excused(waited=3)
    assert excused([(4, 9, 4)], before, reading(20, 5.0)) == Excused()


def test_waiting_at_another_time_excuses_nothing() -> None:
    readings = reading(0, 0.0), reading(20, 9.0), reading(40, 9.0), reading(60, 9.0)
    assert excused([(24, 29, 4)], *readings) == Excused()
    assert excused([(18, 29, 4)], *readings) == Excused(waited=4)
    assert excused([(70, 79, 8)], *readings) == Excused()
    assert excused([(24, 29, 4)]) == Excused()


def test_stolen_time_excuses_what_waiting_does_not() -> None:
    before = reading(0, 0.0)
    assert excused([(4, 19, 14)], before, reading(20, 3.0, stolen_ms=10)) == Excused(3, 10)
    # Of another processor nothing was stolen from the loop.
    assert excused([(4, 19, 14)], before, reading(20, 3.0, 10, processor=1)) == Excused(3, 0)


def test_usual_waiting_excuses_no_miss() -> None:
    # 3 ms of each 20, and one span with 8 ms.
    waits_ms = (0, 3, 6, 9, 17, 20)
    readings = [reading(20 * number, waited_ms) for number, waited_ms in enumerate(waits_ms)]
    assert excused([(24, 29, 3)], *readings) == Excused()
    assert excused([(64, 73, 8)], *readings) == Excused(waited=5)


def test_on_a_machine_that_is_too_busy_nothing_is_judged() -> None:
    calm = LoopFigures(80_000, 20_000, 200.0, Excused(waited=19_900))
    check = judge_calm_loop(calm)[0]
    assert check.ok is None
    assert "not judged" in check.found


def test_the_bar_is_for_the_misses_that_are_the_loops_own() -> None:
    calm = LoopFigures(ticks=95_000, misses=5_000, tick_p99_us=200.0)
    assert judge_calm_loop(calm)[0].ok is False
    check = judge_calm_loop(replace(calm, excused=Excused(waited=4_100, stolen=100)))[0]
    assert check.ok
    texts = ("5.000% of 100000", "4.100% while it waited", "0.100% stolen", "0.800% of its own")
    assert all(text in check.found for text in texts)
    assert judge_calm_loop(replace(calm, excused=Excused(waited=3_900)))[0].ok is False


def test_a_process_that_shares_its_processor_waits_for_it() -> None:
    processor = min(os.sched_getaffinity(0))
    code = f"import os; os.sched_setaffinity(0, {{{processor}}}); print(flush=True)\nwhile 1: pass"
    busy = [ChildProcess("busy process", "-c", code, stdout=PIPE) for _ in range(2)]
    with busy[0] as process, busy[1]:
        for child in busy:
            child.read_line(PATIENCE_S)
        first = read_core_time(process.pid, 0)
        if first is None:
            pytest.skip("this kernel keeps no account of what a thread waits")

        def waited_long() -> bool:
            now = read_core_time(process.pid, 0)
            assert now is not None
            assert now.processor == processor
            return now.waited_ns - first.waited_ns >= 20 * MS

        until(waited_long)
    assert read_core_time(process.pid, 0) is None
