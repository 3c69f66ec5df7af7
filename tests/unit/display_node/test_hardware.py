"""A display's bench under faults, in virtual time."""

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.control.controller import StepperController
from protocol.errors import SourceError
from protocol.faults import Fault, Part
from protocol.faults import FaultKind as Kind
from pulse_drives.withdrawal import TOUCH_N
from tests.support.fault_injection import FaultKind, parse_fault
from tests.support.sender import MS, Sender, display_scene
from tests.support.streams import synthetic
from tests.support.threaded_bench import ThreadedBench

Pulse = Callable[[int], float]
Event = Callable[[ThreadedBench], None]
STILL_MM_PER_S = 1e-3
BAR_MS = 100
TICK_MS = 2
LIMIT_N, MICROSTEP_N = 2.5, 6e-3
SLEW_N_PER_S = 50.0
HANGS_MS = 600


@pytest.fixture(scope="module")
def pulse_n() -> Pulse:
    """Return the paper's pulse as a function of the time in ms."""
    samples = synthetic(preset="paper", rate="1 kHz", peak_to_peak="0.3 N", preload="0.3 N")
    values = samples.take(8_000)[:, 0].tolist()
    return lambda ms: values[ms % len(values)]


@contextmanager
def playing(
    force_n: Pulse, ms: int = 1_200, late_ns: Pulse = lambda _: 0, with_film: bool = True
) -> Iterator[ThreadedBench]:
    """Provide a bench on which a pulse has been played for some time."""
    scene = display_scene("tmcl_bench")
    with ThreadedBench(scene, force_n, with_film, late_ns=late_ns) as bench:
        bench.start()
        bench.run(ms)
        yield bench


def now_ms(bench: ThreadedBench) -> int:
    return bench.world.now_ns // MS


def forces_n(bench: ThreadedBench, since_ms: int = 0) -> NDArray[np.float64]:
    return np.array([m.force_n for m in bench.moments if m.time_ns > since_ms * MS])


def ended_after_ms(bench: ThreadedBench, from_ms: int, pressing: bool = False) -> int:
    """Return the time since from_ms of the last press; of the last motion if it stays pressing."""
    last_ns = from_ms * MS
    for moment in bench.moments:
        moves = abs(moment.speed_m_per_s) > STILL_MM_PER_S
        if moves if pressing else moment.force_n > TOUCH_N:
            last_ns = max(last_ns, moment.time_ns)
    return last_ns // MS - from_ms


def rmse_n(bench: ThreadedBench) -> float:
    """Return the display's own aligned force error."""
    bench.display.finish_scores()
    summary = bench.display.summary()
    assert summary.faults == []
    assert summary.force_rmse_n.aligned is not None
    return summary.force_rmse_n.aligned


@pytest.mark.parametrize(
    "late_us",
    [lambda ms: 0, lambda ms: 300, lambda ms: ms * 7919 % 1000],
    ids=["in time", "0.3 ms late", "up to 1 ms late"],
)
def test_the_pulse_is_followed_through_drive_and_film(
    pulse_n: Pulse, late_us: Callable[[int], int]
) -> None:
    """The times of the commands determine the travel, also of late ones."""
    with playing(pulse_n, 6_000, lambda now_ns: 1_000 * late_us(now_ns // MS)) as bench:
        assert rmse_n(bench) < 0.75e-3


def test_missed_ticks_cost_little(pulse_n: Pulse) -> None:
    with playing(pulse_n, late_ns=lambda _: MS) as bench:
        for _ in range(40):
            bench.stall(4 * TICK_MS)
            bench.run(100)
        assert rmse_n(bench) < 1.5e-3


@pytest.mark.parametrize("name", ["tmcl_bench", "class_bench"])
@pytest.mark.parametrize("stalled_ms", [40, 150])
def test_after_a_stall_the_loop_has_counted_the_travel_that_the_drive_was_sent(
    monkeypatch: pytest.MonkeyPatch, name: str, stalled_ms: int
) -> None:
    """A drive keeps its speed for its watchdog's time; a display board brakes after half of it."""
    scene = display_scene(name)
    assert scene.drive is not None
    patient = scene.drive.model_copy(update={"watchdog_ns": 200 * MS})
    scene = scene.model_copy(update={"drive": patient})
    counted_m, tick_s = [0.0], TICK_MS * 1e-3
    output, skip, shift = (getattr(StepperController, name) for name in ("output", "skip", "shift"))

    def take_output(loop: StepperController, reference_n: list[float], reading_n: float) -> float:
        speed: float = output(loop, reference_n, reading_n)
        counted_m.append(speed * tick_s)
        return speed

    def take_skip(loop: StepperController, speed_m_per_s: float) -> None:
        counted_m.append(speed_m_per_s * tick_s)
        skip(loop, speed_m_per_s)

    def take_shift(loop: StepperController, travel_m: float) -> None:
        counted_m.append(travel_m)
        shift(loop, travel_m)

    monkeypatch.setattr(StepperController, "output", take_output)
    monkeypatch.setattr(StepperController, "skip", take_skip)
    monkeypatch.setattr(StepperController, "shift", take_shift)
    with ThreadedBench(scene, lambda ms: 0.2 + 0.5 * abs(ms % 2_000 / 1_000 - 1)) as bench:
        gaps_m = list[float]()
        bench.on_tick = lambda _, __: gaps_m.append(
            bench.drive.travel_m(bench.world.now_ns) + counted_m[-1] - sum(counted_m)
        )
        bench.start()
        bench.run(2_300)
        before_m = gaps_m[-1]
        bench.stall(stalled_ms)
        bench.run(2 * TICK_MS)
        assert bench.faults == []
        assert gaps_m[-1] - before_m == pytest.approx(0.0, abs=0.2e-6)


def test_ticks_in_which_the_drive_is_slowed_at_its_end_are_counted(pulse_n: Pulse) -> None:
    with playing(pulse_n, 3_000) as gentle:
        assert (gentle.hardware.at_end.times, gentle.hardware.at_end.ticks) == (0, 0)
    with playing(lambda ms: 10 * pulse_n(ms), 3_000) as hard:
        limited = hard.display.summary().limited
        assert hard.hardware.at_end.times > 0
    assert limited.force.share == pytest.approx(0.7, abs=0.3)
    # On a real bench, the drive bounds the travel, and the model of the film nothing.
    assert (limited.travel.times, limited.film.times) == (hard.hardware.at_end.times, None)


def lose_the_film(bench: ThreadedBench) -> None:
    bench.film.silent = True


def lose_the_stream(bench: ThreadedBench) -> None:
    bench.sending = False


def overheat(bench: ThreadedBench) -> None:
    bench.motor.fail("overtemperature")


def hang(bench: ThreadedBench) -> None:
    bench.world.stall(bench.threads, bench.world.now_ns + HANGS_MS * MS)


@pytest.mark.parametrize(
    ("happens", "pressing", "fault"),
    [
        (lose_the_film, False, "film: feedback lost"),
        (lose_the_stream, False, None),
        (overheat, True, "drive: fault: overtemperature"),
        (hang, True, None),
    ],
    ids=["feedback lost", "stale stream", "drive fault", "process hangs"],
)
@pytest.mark.parametrize("from_ms", [1_200, 1_977])
def test_within_100_ms_of_a_fault_the_tip_rests_or_is_off_the_finger(
    pulse_n: Pulse, happens: Event, pressing: bool, fault: str | None, from_ms: int
) -> None:
    with playing(pulse_n, from_ms) as bench:
        began_ms = now_ms(bench)
        assert bench.moments[-1].force_n > 0.1
        happens(bench)
        bench.run(HANGS_MS - 1)
    assert ended_after_ms(bench, began_ms, pressing) <= BAR_MS
    assert bench.faults == ([fault] if fault else [])
    # A drive that is held by its own fault does not withdraw.
    assert (bench.motor.force_n > 0.1) == pressing


def test_a_withdrawal_that_fails_is_a_fault_as_well(pulse_n: Pulse) -> None:
    with playing(pulse_n, 1_200) as bench:
        stuck = parse_fault(FaultKind.NO_RETRACTION, None)
        bench.motor.injector.begin(stuck, bench.world.now_ns)
        lose_the_film(bench)
        bench.run(1_000)
    assert len(bench.faults) == 2
    assert bench.faults[-1] == "drive: withdrawal: unconfirmed"


def test_a_slow_first_tick_is_no_fault_since_the_drive_rests_at_first_touch(pulse_n: Pulse) -> None:
    with ThreadedBench(display_scene("tmcl_bench"), pulse_n) as bench:
        bench.start(loop_after_ms=204)
        bench.run(2_000)
        assert bench.faults == []
        assert bench.moments[-1].force_n > 0.05


@pytest.mark.parametrize(
    "force_n",
    [
        lambda ms: 1_000.0,
        lambda ms: 9e5 if ms // 40 % 2 else -9e5,
        lambda ms: 9e5 if ms % 2 else -9e5,
    ],
    ids=["1000 N", "±900 kN", "±900 kN each sample"],
)
def test_no_peer_presses_harder_or_faster_than_safety_allows(force_n: Pulse) -> None:
    with playing(force_n, 0) as bench:
        targets_n = list[float]()
        bench.on_tick = lambda _, target_n: targets_n.append(target_n)
        bench.run(3_000)
    felt_n = forces_n(bench)
    assert felt_n.max() <= LIMIT_N + MICROSTEP_N
    within_n = felt_n[10:] - felt_n[:-10]
    assert within_n.max() <= SLEW_N_PER_S * 10e-3 * 1.1
    assert np.diff(targets_n).max() <= SLEW_N_PER_S * TICK_MS * 1e-3 * (1 + 1e-9)
    assert bench.faults == []


def test_a_restarted_sensing_node_is_felt_after_a_ramp() -> None:
    with playing(lambda ms: 0.5) as bench:
        bench.sending = False
        bench.run(1_000)
        assert bench.moments[-1].force_n == 0
        bench.sender, bench.sending, began_ms = Sender(session=8), True, now_ms(bench)
        bench.run(3_000)
    felt_n = forces_n(bench, began_ms)
    begins, full = np.argmax(felt_n > 0.02), np.argmax(felt_n > 0.48)
    assert felt_n[-1] == pytest.approx(0.5, abs=2e-3)
    # From 4 % to 96 %.
    assert full - begins > 0.9 * bench.scene.safety.ramp_ns / MS
    assert np.diff(felt_n).max() < 5e-3


@pytest.mark.parametrize("happens", [lose_the_film, overheat, hang])
def test_after_a_fault_and_a_restart_the_force_returns_by_a_ramp(happens: Event) -> None:
    with playing(lambda ms: 0.5) as bench:
        happens(bench)
        bench.run(2 * HANGS_MS)
        assert bench.faults
        bench.stop()
        bench.motor.reset()
        bench.film.silent = False
        bench.start()
        began_ms = now_ms(bench)
        bench.run(3_000)
        assert bench.faults == []
    felt_n = forces_n(bench, began_ms)
    begins = int(np.argmax(felt_n > 0.01))
    ramp_n = 0.5 * np.arange(len(felt_n) - begins) * MS / bench.scene.safety.ramp_ns
    assert (felt_n[begins:] <= ramp_n + 0.03).all()
    assert felt_n[-1] == pytest.approx(0.5, abs=2e-3)


def test_without_the_films_first_sample_no_drive_moves(pulse_n: Pulse) -> None:
    with ThreadedBench(display_scene("tmcl_bench"), pulse_n) as bench:
        lose_the_film(bench)
        with pytest.raises(SourceError, match="no sample within 5 s"):
            bench.start()
    assert {moment.speed_m_per_s for moment in bench.moments} == {0.0}


def test_without_a_sensor_the_drives_position_gives_the_force() -> None:
    with playing(lambda ms: 0.5, with_film=False) as bench:
        feedback, now_ns = bench.hardware.feedback, bench.world.now_ns
        bench.hardware.read()
        samples = feedback.samples
        # A report that is read twice is one sample.
        bench.hardware.read()
        assert feedback.samples == samples
        read_n = feedback.read(now_ns)
        assert read_n == pytest.approx(bench.motor.force_n, abs=5e-3)
        finger = bench.hardware.finger(now_ns)
        assert finger.measured_by == "by the drive's position"
        # A status reads nothing anew: it has the newest report, and the loop one of a fixed age.
        assert finger.force_n == pytest.approx(read_n, abs=5e-3)
        assert feedback.samples == samples


def test_an_end_that_may_still_press_is_a_fault(pulse_n: Pulse) -> None:
    with playing(pulse_n, 1_200) as bench:
        stuck = parse_fault(FaultKind.NO_RETRACTION, None)
        bench.motor.injector.begin(stuck, bench.world.now_ns)
        faults: list[Fault | None] = []
        bench.call(lambda: faults.append(bench.hardware.withdraw()))
        assert bench.motor.force_n > 0.1
    (fault,) = faults
    assert fault is not None
    assert fault.kind is Kind.STILL_PRESSED
    assert re.fullmatch(r"the tip may still press .* is unconfirmed, with \d+ mN", fault.cause)
    assert "switch the drive's power off" in fault.remedy


def test_an_end_that_leaves_the_finger_is_none(pulse_n: Pulse) -> None:
    with playing(pulse_n, 1_200) as bench:
        faults: list[Fault | None] = []
        bench.call(lambda: faults.append(bench.hardware.withdraw()))
        assert bench.motor.force_n == 0.0
    assert faults == [None]


def test_without_a_film_a_silent_drive_is_named_as_such() -> None:
    """The positions stand in for a film, whose time-out of 40 ms must not name the film."""
    with playing(lambda ms: 0.5, with_film=False) as bench:
        lost = parse_fault(FaultKind.LOST, "1")
        bench.motor.injector.begin(lost, bench.world.now_ns)
        bench.run(200)
    (first, *_) = bench.faults
    assert first.startswith("drive: no answer")


@pytest.mark.parametrize(("contactor", "trusted"), [("", False), ("another", True)])
def test_the_film_of_another_contactor_says_nothing_of_this_one(
    contactor: str, trusted: bool
) -> None:
    """A film that is false decides nothing in the withdrawal, and is not shown: its own alone."""
    with playing(lambda ms: 0.5) as bench:
        fault = Fault(Kind.FROZEN, Part.FILM, "frozen", bench.world.now_ns, contactor)
        bench.display.fade.fault(fault)
        bench.run(5)
        withdrawal = bench.drive._supervisor.withdrawal
        assert withdrawal is not None
        assert withdrawal._film_trusted is trusted
        bench.run(200)
        shown = bench.hardware.finger(bench.world.now_ns)
        assert (shown.force_n is not None) is trusted
        assert bench.motor.force_n == 0.0
