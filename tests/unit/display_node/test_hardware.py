"""A display's bench under faults, in virtual time."""

import re
import time
from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest

from display_node.scene import DisplayScene
from protocol.errors import SceneError, SourceError
from pulse_drives.supervisor import DriveStatus
from pulse_drives.withdrawal import WithdrawalOutcome
from pulse_sensors.samples import SampleBlock
from tests.support.sender import MS, Sender, display_scene
from tests.support.streams import synthetic
from tests.support.virtual_bench import TICK_MS, VirtualBench
from tests.support.virtual_time import VirtualTime

Pulse = Callable[[float], float]
Event = Callable[[VirtualBench], None]
STILL_MM_PER_S = 1e-3
BAR_MS = 100
LIMIT_N = 2.5
SLEW_N_PER_S = 50.0


@pytest.fixture(scope="module")
def pulse_n() -> Pulse:
    """Return the paper's pulse as a function of the time in ms."""
    samples = synthetic(preset="paper", rate="1 kHz", peak_to_peak="0.3 N", preload="0.3 N")
    values = samples.take(8_000)[:, 0].tolist()
    return lambda ms: values[max(0, int(ms)) % len(values)]


def ended_after_ms(bench: VirtualBench, from_ms: int, pressing: bool = False) -> int:
    """Return the time since from_ms of the last press; of the last motion if it stays pressing."""
    last_ns = from_ms * MS
    for moment in bench.moments:
        moves = abs(moment.speed_m_per_s) > STILL_MM_PER_S
        if moves if pressing else moment.force_n > 0:
            last_ns = max(last_ns, moment.time_ns)
    return last_ns // MS - from_ms


@pytest.mark.parametrize(
    ("late_us", "most_mn"),
    [(lambda ms: 0, 0.4), (lambda ms: 300, 0.45), (lambda ms: ms * 7919 % 1000, 0.45)],
    ids=["in time", "0.3 ms late", "up to 1 ms late"],
)
def test_the_pulse_is_followed_through_drive_and_film(
    pulse_n: Pulse, late_us: Callable[[int], int], most_mn: float
) -> None:
    """The times of the commands determine the travel, also of late ones."""
    bench = VirtualBench(pulse_n)
    bench.command_late_ns = lambda ms: 1_000 * late_us(ms)
    bench.run(6_000)
    assert rmse_n(bench) < most_mn * 1e-3


def test_missed_ticks_cost_little(pulse_n: Pulse) -> None:
    bench = VirtualBench(pulse_n)
    bench.command_late_ns = lambda ms: MS
    bench.run(1_200)
    for _ in range(40):
        bench.stall(4 * TICK_MS)
        bench.run(100)
    assert rmse_n(bench) < 1.4e-3


def test_ticks_in_which_the_drive_is_slowed_at_its_end_are_counted(pulse_n: Pulse) -> None:
    gentle, hard = VirtualBench(pulse_n), VirtualBench(lambda ms: 10 * pulse_n(ms))
    for bench in (gentle, hard):
        bench.run(3_000)
    assert (gentle.hardware.at_end.times, gentle.hardware.at_end.ticks) == (0, 0)
    at_end, limited = hard.hardware.at_end, hard.display.summary().limited
    assert at_end.times > 0
    assert limited.force.share == pytest.approx(0.7, abs=0.3)
    # On a real bench, the models of actuator and film bound nothing.
    assert (limited.travel.times, limited.film.times) == (None, None)


def rmse_n(bench: VirtualBench) -> float:
    """Return the display's own aligned force error."""
    bench.display.tracking_errors[0].finish()
    summary = bench.display.summary()
    assert summary.faults == []
    assert summary.force_rmse_n.aligned is not None
    return summary.force_rmse_n.aligned


def lose_the_film(bench: VirtualBench) -> None:
    bench.film.silent = True


def lose_the_stream(bench: VirtualBench) -> None:
    bench.sending = False


def overheat(bench: VirtualBench) -> None:
    bench.drive.motor.fail("overtemperature")


def hang(bench: VirtualBench) -> None:
    bench.loop_runs = bench.thread_runs = False


@pytest.mark.parametrize(
    ("happens", "pressing", "fault"),
    [
        (lose_the_film, False, "feedback lost"),
        (lose_the_stream, False, None),
        (overheat, True, "drive: fault: overtemperature"),
        (hang, True, None),
    ],
    ids=["feedback lost", "stale stream", "drive fault", "process hangs"],
)
@pytest.mark.parametrize("from_ms", [1_200, 1_330, 1_511, 1_702, 1_977])
def test_within_100_ms_of_a_fault_the_tip_rests_or_is_off_the_finger(
    pulse_n: Pulse, happens: Event, pressing: bool, fault: str | None, from_ms: int
) -> None:
    bench = VirtualBench(pulse_n)
    bench.run(from_ms)
    began_ms = bench.now_ms
    assert bench.moments[-1].force_n > 0.1
    happens(bench)
    bench.run(600)
    assert ended_after_ms(bench, began_ms, pressing) <= BAR_MS
    assert bench.display.safety.faults[:1] == ([fault] if fault else [])
    # A drive that is held by its own fault does not withdraw.
    assert (bench.display.safety.faults[1:] == ["withdrawal: unconfirmed"]) == (happens is overheat)


def test_each_tick_reads_the_drives_status_once_before_and_after_a_fault(
    pulse_n: Pulse, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = VirtualBench(pulse_n)
    calls, status = [0], bench.drive.status

    def counted() -> DriveStatus:
        calls[0] += 1
        return status()

    monkeypatch.setattr(bench.drive, "status", counted)
    for fault in (False, True):
        if fault:
            lose_the_film(bench)
            bench.run(100)
        assert bool(bench.display.safety.faults) == fault
        calls[0], ticks = 0, bench.display.ticks
        bench.run(500)
        assert calls[0] == bench.display.ticks - ticks
    calls[0] = 0
    bench.hardware.finger(bench.now_ms * MS)
    assert calls[0] == 1


@pytest.mark.parametrize("loop_first", [False, True], ids=["the drive's thread", "the loop"])
@pytest.mark.parametrize("stalled_ms", [70, 100, 400, 1_000, 10_000])
@pytest.mark.parametrize("from_ms", [1_200, 1_511, 1_977])
def test_after_a_stall_the_tip_withdraws_whichever_thread_wakes_first(
    pulse_n: Pulse, loop_first: bool, stalled_ms: int, from_ms: int
) -> None:
    bench = VirtualBench(pulse_n)
    bench.run(from_ms)
    bench.loop_first = loop_first
    bench.stall(stalled_ms)
    assert bench.moments[-1].force_n > 0.1
    woke_ms = bench.now_ms
    bench.run(1_000)
    (fault,) = bench.display.safety.faults
    assert re.search(r"no command for \d+ ms", fault)
    assert ended_after_ms(bench, woke_ms) < 300
    assert bench.hardware.finger(bench.now_ms * MS).outcome is WithdrawalOutcome.WITHDRAWN


def test_a_loop_that_hangs_alone_leaves_the_withdrawal_to_the_drives_thread(pulse_n: Pulse) -> None:
    bench = VirtualBench(pulse_n)
    bench.run(1_200)
    bench.loop_runs = False
    bench.run(500)
    assert bench.moments[-1].force_n == 0


def test_a_long_overrun_is_a_fault_whatever_the_drive_reports(pulse_n: Pulse) -> None:
    bench = VirtualBench(pulse_n)
    bench.run(1_200)
    bench.drive.motor.set_watchdog(0)
    bench.loop_first = True
    bench.stall(300)
    began_ms = bench.now_ms
    bench.run(500)
    (fault,) = bench.display.safety.faults
    assert "no command for 30" in fault
    assert bench.moments[-1].force_n == 0
    # During the stall, the drive moved for 300 ms, up to its soft limit.
    assert ended_after_ms(bench, began_ms) <= 3 * BAR_MS


def test_a_slow_first_tick_is_no_fault_since_the_drive_rests_at_first_touch(pulse_n: Pulse) -> None:
    bench = VirtualBench(pulse_n)
    bench.loop_runs = False
    bench.run(204)
    bench.loop_runs = True
    bench.run(2_000)
    assert bench.display.safety.faults == []
    assert bench.moments[-1].force_n > 0.05


@pytest.mark.parametrize(
    "force_n",
    [
        lambda ms: 1_000.0,
        lambda ms: 9e5 if int(ms) // 40 % 2 else -9e5,
        lambda ms: 9e5 if int(ms) % 2 else -9e5,
    ],
    ids=["1000 N", "±900 kN", "±900 kN each sample"],
)
def test_no_peer_presses_harder_or_faster_than_safety_allows(force_n: Pulse) -> None:
    bench = VirtualBench(force_n)
    bench.run(3_000)
    felt_n = np.array([moment.force_n for moment in bench.moments])
    assert felt_n.max() <= LIMIT_N
    within_n = felt_n[10:] - felt_n[:-10]
    assert within_n.max() <= SLEW_N_PER_S * 10e-3 * 1.1
    target_n = np.array([target_n for _, target_n, _ in bench.felt])
    assert np.diff(target_n).max() <= SLEW_N_PER_S * TICK_MS * 1e-3 * (1 + 1e-9)
    assert bench.display.safety.faults == []


def test_a_restarted_sensing_node_is_felt_after_a_ramp() -> None:
    bench = VirtualBench(lambda ms: 0.5)
    bench.run(1_200)
    bench.sending = False
    bench.run(1_000)
    assert bench.moments[-1].force_n == 0
    bench.sender, bench.sending = Sender(session=8), True
    bench.run(3_000)
    felt_n = np.array([moment.force_n for moment in bench.moments])[2_100:]
    begins, full = np.argmax(felt_n > 0.02), np.argmax(felt_n > 0.48)
    assert felt_n[-1] == pytest.approx(0.5, abs=2e-3)
    # From 4 % to 96 %.
    assert full - begins > 0.9 * bench.scene.safety.ramp_ns / MS
    assert np.diff(felt_n).max() < 5e-3


@pytest.mark.parametrize("happens", [lose_the_film, overheat, hang])
def test_after_a_fault_and_a_restart_the_force_returns_by_a_ramp(happens: Event) -> None:
    bench = VirtualBench(lambda ms: 0.5)
    bench.run(1_200)
    happens(bench)
    bench.run(200)
    bench.loop_runs = bench.thread_runs = True
    bench.run(400)
    assert bench.display.safety.faults
    bench.restart()
    began = len(bench.moments)
    bench.run(3_000)
    assert bench.display.safety.faults == []
    felt_n = np.array([moment.force_n for moment in bench.moments[began:]])
    begins = int(np.argmax(felt_n > 0.01))
    ramp_n = 0.5 * np.arange(len(felt_n) - begins) * MS / bench.scene.safety.ramp_ns
    assert (felt_n[begins:] <= ramp_n + 0.03).all()
    assert felt_n[-1] == pytest.approx(0.5, abs=2e-3)


def test_errors_are_counted_and_named() -> None:
    bench = VirtualBench(lambda ms: 0.3)
    bench.drive.counts["superseded"], bench.film.rejected["garbled"] = 3, 2
    assert bench.hardware.counts == Counter({"drive superseded": 3, "film garbled": 2})
    bench.hardware.feedback.add(0, 0.1)
    assert bench.hardware.counts["film out of order"] == 1
    lose_the_film(bench)
    assert bench.hardware.faults() == ["the film is torn"]


def test_closing_withdraws_the_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = VirtualBench(lambda ms: 0.5)
    bench.run(1_200)
    assert bench.moments[-1].force_n > 0.4

    def sleep(seconds: float) -> None:
        for _ in range(round(seconds * 1e3)):
            bench.drive.run_thread(bench.drive.now_ns + MS)

    monkeypatch.setattr(time, "sleep", sleep)
    bench.hardware.close()
    assert (bench.drive.motor.force_n, bench.drive.closed, bench.film.closed) == (0, True, True)


@pytest.fixture
def scene() -> DisplayScene:
    return display_scene("tmcl_bench")


class QuietFilm:
    """A film with a sample in each poll from a given one on."""

    def __init__(self, world: VirtualTime, first: int) -> None:
        self._world, self._first = world, first
        self.rejected: Counter[str] = Counter()
        self.polls = 0

    def poll(self) -> list[SampleBlock]:
        self.polls += 1
        now_ns = self._world.now_ns + self.polls
        block = SampleBlock(np.array([[0.1]]), 0, now_ns, now_ns + MS)
        return [block] if self.polls >= self._first else []


@pytest.mark.parametrize("first", [3, 10_000])
def test_a_bench_starts_with_the_films_first_sample(scene: DisplayScene, first: int) -> None:
    bench, world = VirtualBench(lambda ms: 0.3), VirtualTime()
    film = QuietFilm(world, first)
    with world.substituted(("display_node.hardware",)):
        started = scene.hardware(bench.drive, film)  # type: ignore[arg-type]
        if first == 10_000:
            with pytest.raises(SourceError, match="no sample within 5 s"):
                started.start()
            return
        started.start()
    # The first sample has come before the drive moves.
    assert film.polls == 4
    assert started.feedback.samples == 2


def test_without_a_sensor_the_drives_position_gives_the_force(scene: DisplayScene) -> None:
    bench = VirtualBench(lambda ms: 0.5)
    bench.run(1_200)
    found = scene.hardware(bench.drive, sensor=None)
    found.read()
    found.read()
    read_n = found.feedback.read(bench.now_ms * MS)
    assert read_n == pytest.approx(bench.drive.motor.force_n, rel=1e-6)
    # A report that is read twice is one sample.
    assert found.feedback.samples == 1
    assert found.counts == Counter()
    finger = found.finger(bench.now_ms * MS)
    assert (finger.force_n, finger.measured_by) == (read_n, "by the drive's position")


def test_a_scene_without_a_drive_is_refused(scene: DisplayScene) -> None:
    bench = VirtualBench(lambda ms: 0.3)
    with pytest.raises(SceneError, match="drive"):
        scene.model_copy(update={"drive": None}).hardware(bench.drive, None)
