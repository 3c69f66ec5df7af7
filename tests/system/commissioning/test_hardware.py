"""The real-time part on a drive and a film that are exact whatever this machine is busy with."""

import time
from collections import Counter, deque

import numpy as np
import pytest

from display_node.drives.following_error import CommandedPosition
from display_node.drives.supervisor import DriveStatus
from display_node.drives.withdrawal import WithdrawalOutcome
from display_node.plant.stepper import Stepper, StepperScene
from display_node.scene import DisplayScene
from protocol.errors import BenchError, DriveError
from pulse_sensors.samples import SampleBlock
from telepulse.commissioning.actuator_check import check_actuator
from telepulse.commissioning.press import PressRecorder, press_stepper
from telepulse.commissioning.rig import HardwareRig, check_answers, listen
from telepulse.commissioning.sensor_check import judge_sensor, measure
from tests.unit.telepulse.commissioning.test_press import bench

MS = 1_000_000
TICK_S = 4e-3
STEP_M = 6.25e-7


class Bench:
    """A drive that obeys `late_ms` after it was told, and the film under its finger, 1 kHz."""

    def __init__(self, scene: DisplayScene, actuator: StepperScene, late_ms: int) -> None:
        law = actuator.contact(scene.layer.layer())
        self._stepper = Stepper(actuator, law, 2.5, 1e-3)
        self._told_m_per_s = 0.0
        self._queue: deque[tuple[int, float]] = deque()
        self._now_ns = time.monotonic_ns()
        self._late_ns = late_ms * MS
        self._samples: list[tuple[int, float]] = []
        self.fault: str | None = None
        self.counts: Counter[str] = Counter()
        self.withdrawals = 0
        self._way = CommandedPosition()
        self._outcome: WithdrawalOutcome | None = None

    def _advance(self) -> None:
        while self._now_ns + MS <= time.monotonic_ns():
            self._now_ns += MS
            while self._queue and self._queue[0][0] <= self._now_ns - MS // 2:
                self._told_m_per_s = self._queue.popleft()[1]
            self._samples.append((self._now_ns, self._stepper.step(self._told_m_per_s / STEP_M)))

    def start(self) -> None:
        """Do nothing."""

    def command(self, speed_m_per_s: float) -> None:
        # Told at one of its own instants, so that the way it says is the way it goes.
        self._advance()
        self._way.record(speed_m_per_s, self._now_ns)
        self._queue.append((self._now_ns + self._late_ns, speed_m_per_s))

    def travel_m(self, now_ns: int) -> float:
        return self._way.travel_m(now_ns)

    def status(self) -> DriveStatus:
        self._advance()
        speed = self._told_m_per_s
        place_m = self._stepper.screw_m
        if self._outcome is WithdrawalOutcome.UNDER_WAY and place_m <= 0:
            self._outcome, self._told_m_per_s = WithdrawalOutcome.WITHDRAWN, 0.0
        return DriveStatus(place_m, speed, self.fault, speed != 0, self._now_ns, self._outcome)

    def withdraw(self, reason: str) -> None:
        self.withdrawals += 1
        self._outcome = WithdrawalOutcome.UNDER_WAY
        self._queue.clear()
        self._told_m_per_s = -0.02

    def close(self) -> None:
        """Do nothing."""

    def poll(self) -> list[SampleBlock]:
        self._advance()
        samples, self._samples = self._samples, []
        return [
            SampleBlock(np.array([[force_n]]), 0, at_ns, at_ns + MS) for at_ns, force_n in samples
        ]

    def faults(self) -> list[str]:
        return ["it is unplugged"]


@pytest.fixture
def scene() -> DisplayScene:
    return bench()[0]


def test_a_real_bench_is_identified(scene: DisplayScene) -> None:
    _, actuator = bench(fingertip_n_per_m=1300.0)
    drive = Bench(scene, actuator, late_ms=6)
    rig = HardwareRig(drive, drive, TICK_S)  # type: ignore[arg-type]
    # A loaded machine may not look at the film for long.
    patient = scene.safety.model_copy(update={"feedback_within_ns": 10**10})
    found = check_actuator(rig, scene.model_copy(update={"safety": patient}), 0.3, 0.0)
    assert found.contact is not None
    assert found.contact.finger_n_per_m == pytest.approx(1300.0, rel=0.05)
    assert found.identified.delay_s == pytest.approx(6e-3, abs=2e-3)
    assert drive.withdrawals == 0


@pytest.mark.parametrize("why", ["too much", "silent"])
def test_a_press_that_is_given_up_goes_back_off_the_finger(scene: DisplayScene, why: str) -> None:
    _, actuator = bench()
    drive = Bench(scene, actuator, late_ms=0)
    rig = HardwareRig(drive, drive, TICK_S)  # type: ignore[arg-type]
    pressed_n = []

    def poll() -> list[SampleBlock]:
        readings = Bench.poll(drive)
        pressed_n.extend(reading.force_n[0] for reading in readings)
        return readings if why == "too much" or max(pressed_n, default=0.0) < 0.05 else []

    drive.poll = poll  # type: ignore[method-assign]
    with pytest.raises(BenchError, match="stopped pressing and went back"):
        press_stepper(PressRecorder(rig, 0.1, 0.3), actuator, 0.3)
    assert max(pressed_n) > 0.05
    assert drive.withdrawals == 1
    assert Bench.poll(drive)[-1].force_n[0] == pytest.approx(0.0, abs=5e-3)


def test_a_drive_that_fails_ends_the_press(scene: DisplayScene) -> None:
    _, actuator = bench()
    drive = Bench(scene, actuator, late_ms=0)
    rig = HardwareRig(drive, drive, TICK_S)  # type: ignore[arg-type]
    rig.tick(0.0)
    drive.fault = "overtemperature"
    with pytest.raises(DriveError, match="the drive stopped: overtemperature"):
        rig.tick(0.0)
    with pytest.raises(DriveError, match="overtemperature"):
        check_answers(drive)


def test_the_drives_answer_is_timed(scene: DisplayScene) -> None:
    _, actuator = bench()
    late = check_answers(Bench(scene, actuator, late_ms=150))
    assert late.verdict == "fail"
    assert "p99" in late.found


def test_listening_gives_every_sample_its_time(scene: DisplayScene) -> None:
    _, actuator = bench()
    sensor = Bench(scene, actuator, late_ms=0)
    heard = listen(sensor, 0.3)  # type: ignore[arg-type]
    figures = measure(heard)
    assert figures.rate_hz == pytest.approx(1000.0)
    assert {c.name: c.verdict for c in judge_sensor(figures, 1000.0)}["rate"] == "ok"


def test_a_sensor_that_says_nothing_is_named() -> None:
    class Mute:
        def poll(self) -> list[SampleBlock]:
            return []

        def faults(self) -> list[str]:
            return ["it is unplugged"]

    with pytest.raises(BenchError, match=r"no sample came in 0\.1 s: it is unplugged"):
        listen(Mute(), 0.1)  # type: ignore[arg-type]
