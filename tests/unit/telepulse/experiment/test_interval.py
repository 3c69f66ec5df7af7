from pathlib import Path

from telepulse.experiment.interval import (
    Interval,
    IntervalPlayback,
    PlayedInterval,
    draw_interval,
    play_in_virtual_time,
)
from telepulse.experiment.session import Trial
from tests.support.experiment_sessions import condition, plan

SLOW = condition("slow", "delay=200ms,jitter=10ms", "auto")


def intervals(folder: Path, *conditions: str, **keys: object) -> dict[str, Interval]:
    """Draw A, B and X of a trial in which X is over the link."""
    found = plan(folder, *conditions, **keys)
    name = found.session.conditions[0].name
    trial = Trial(condition=name, direct="A", x="B", pulse_seed=5)
    letters = ("A", "B", "X")
    return {x: draw_interval(found, 1, 0, trial, x, 1) for x in letters}


def forces(
    interval: Interval, stop_ns: int | None = None
) -> tuple[list[tuple[int, float]], PlayedInterval]:
    """Play an interval; return time and felt force of each tick, and the interval's record."""
    playing, now_ns, felt = IntervalPlayback(interval, 0), 0, []
    while playing.tick(now_ns):
        felt.append((now_ns, playing.display.states[0].felt_n))
        now_ns += interval.scene.display.tick_ns
        if stop_ns is not None and now_ns >= stop_ns:
            playing.stop(stop_ns)
    return felt, playing.played()


def test_begin_and_length_do_not_depend_on_the_link(tmp_path: Path) -> None:
    for interval in intervals(tmp_path, SLOW, interval="0.4 s").values():
        felt, played = forces(interval)
        pressed_ns = [now_ns for now_ns, force_n in felt if force_n > 0.002]
        # The ramp has begun; it fades and is over.
        assert 0 < pressed_ns[0] - interval.foreperiod_ns < 20_000_000
        over_ns = interval.foreperiod_ns + interval.felt_ns
        assert 0 < pressed_ns[-1] - over_ns < 80_000_000
        assert felt[-1][1] < 0.002
        assert abs(played.felt_s - 0.4) < 0.01


def test_x_has_the_same_beats_and_other_random_numbers(tmp_path: Path) -> None:
    found = intervals(tmp_path)
    assert len({interval.scene.sensing for interval in map(found.get, "ABX") if interval}) == 1
    assert found["B"].scene == found["X"].scene
    assert found["A"].scene != found["X"].scene
    assert len({interval.link_seed for interval in found.values()}) == 3
    assert len({interval.foreperiod_ns for interval in found.values()}) == 3
    b, x = play_in_virtual_time(found["B"]), play_in_virtual_time(found["X"])
    assert b.on_link
    assert x.on_link
    assert b.aligned_n != x.aligned_n


def test_a_direct_interval_is_as_good_as_the_loop_and_a_bad_link_is_not(tmp_path: Path) -> None:
    found = intervals(tmp_path, interval="0.8 s")
    direct, impaired = play_in_virtual_time(found["A"]), play_in_virtual_time(found["B"])
    assert not direct.on_link
    assert direct.aligned_n is not None
    assert impaired.aligned_n is not None
    assert direct.aligned_n < 0.5e-3
    assert impaired.aligned_n > 10e-3
    assert 0.2 < direct.pulse_n < 0.4


def test_a_stopped_interval_ends_at_once(tmp_path: Path) -> None:
    interval = intervals(tmp_path, interval="5 s")["A"]
    stop_ns = interval.foreperiod_ns + 1_000_000_000
    felt, _ = forces(interval, stop_ns)
    after = [(now_ns - stop_ns, force_n) for now_ns, force_n in felt if now_ns > stop_ns]
    assert all(force_n < 0.002 for since_ns, force_n in after if since_ns > 80_000_000)
    assert after[-1][0] < 1_000_000_000
    assert max(force_n for now_ns, force_n in felt) > 0.2
