"""The real-time part of a bench check, on an emulated drive and its film in virtual time."""

from collections.abc import Iterator

import numpy as np
import pytest

from protocol.errors import BenchError, DriveError
from protocol.wire.description import Channel
from pulse_drives.drive import PERIOD_S
from pulse_drives.scene import Cia402Scene, TmclScene, can_frame_bits
from pulse_sensors.samples import SampleBlock
from telepulse.commissioning.actuator_check import check_actuator
from telepulse.commissioning.press import PressRecorder, press_stepper
from telepulse.commissioning.rig import (
    ANSWERS,
    HardwareRig,
    check_answers,
    check_line,
    listen,
)
from telepulse.commissioning.sensor_check import judge_sensor
from tests.support.drive_benches import Bench, tmcl_scene, virtual_bench
from tests.unit.telepulse.commissioning.test_press import bench as press_bench

MS = 1_000_000
TICK_S = 4e-3


class Film:
    """The film under an emulated motor, 1 kHz. silent: it sends nothing."""

    channels = (Channel("film"),)

    def __init__(self, bench: Bench) -> None:
        self._motor, self._clock = bench.motor, bench.clock
        self.silent = False
        self.peak_n = 0.0

    def poll(self) -> list[SampleBlock]:
        forces_n, end_ns = self._motor.forces_n, self._clock.now_ns // MS * MS
        values = np.array([[forces_n.popleft()] for _ in range(len(forces_n))])
        if not len(values) or self.silent:
            return []
        self.peak_n = max(self.peak_n, values.max())
        return [SampleBlock(values, 0, end_ns - len(values) * MS, end_ns)]

    def faults(self) -> list[str]:
        return ["it is unplugged"]


SCENE, ACTUATOR = press_bench()


@pytest.fixture
def bench() -> Iterator[Bench]:
    _, harder = press_bench(fingertip_n_per_m=1300.0)
    with virtual_bench("cia402", actuator=harder, also=("telepulse.commissioning",)) as bench:
        yield bench


@pytest.fixture
def film(bench: Bench) -> Film:
    return Film(bench)


@pytest.fixture
def rig(bench: Bench, film: Film) -> HardwareRig:
    bench.start()
    return HardwareRig(bench.drive, film, TICK_S)


def test_a_bench_is_identified_over_its_line(rig: HardwareRig, bench: Bench) -> None:
    found = check_actuator(rig, SCENE, 0.3, 0.0)
    assert found.contact is not None
    assert found.contact.finger_n_per_m == pytest.approx(1300.0, rel=0.05)
    assert found.identified.delay_s == pytest.approx(1e-3, abs=2e-3)
    assert bench.fault == ""


@pytest.mark.parametrize("silent", [False, True], ids=["too much force", "silent film"])
def test_a_press_that_is_given_up_goes_back_off_the_finger(
    rig: HardwareRig, bench: Bench, film: Film, silent: bool
) -> None:
    def watch() -> None:
        film.silent = silent and film.peak_n > 0.05

    bench.clock.every(MS, watch)
    with pytest.raises(BenchError, match="the press was stopped and the tip went back"):
        press_stepper(PressRecorder(rig, 0.1, 0.3), ACTUATOR, 0.3)
    assert film.peak_n > 0.05
    assert bench.fault == "ended"
    assert bench.motor.force_n == pytest.approx(0.0, abs=5e-3)


def test_a_drive_that_fails_ends_the_press(rig: HardwareRig, bench: Bench) -> None:
    rig.tick(0.0)
    bench.motor.fail("overtemperature")
    bench.clock.sleep(0.02)
    with pytest.raises(DriveError, match="the drive stopped: drive: fault: overtemperature"):
        rig.tick(0.0)
    with pytest.raises(DriveError, match="overtemperature"):
        check_answers(bench.drive)


@pytest.mark.parametrize(("late_ms", "verdict"), [(0, "ok"), (120, "fail")])
def test_the_drives_answer_is_timed(late_ms: int, verdict: str) -> None:
    keys = {"watchdog": "800 ms", "also": ("telepulse.commissioning",)}
    with virtual_bench("cia402", **keys) as bench:
        bench.start()
        send = bench.line.far.send
        bench.line.far.send = lambda message: bench.clock.at(
            bench.clock.now_ns + late_ms * MS, lambda: send(message)
        )
        check = check_answers(bench.drive)
        bench.line.far.send = send
    assert check.verdict == verdict
    assert "p99" in check.text


def test_an_answer_is_awaited_with_no_more_commands_than_a_line_takes() -> None:
    with virtual_bench("stepdir", also=("telepulse.commissioning",)) as bench:
        bench.start()
        commanded_ns = []
        command = bench.drive.command

        def note(speed_m_per_s: float) -> None:
            commanded_ns.append(bench.clock.now_ns)
            command(speed_m_per_s)

        bench.drive.command = note
        check_answers(bench.drive)
        seconds = (commanded_ns[-1] - commanded_ns[0]) * 1e-9
        # The first command of each answer may come early.
        assert len(commanded_ns) <= seconds / PERIOD_S + ANSWERS + 1


def test_a_record_has_every_samples_time(rig: HardwareRig, film: Film) -> None:
    (record,) = listen(film, 0.3).values()
    rate = judge_sensor(record, 1000.0)[0]
    assert (rate.name, rate.text, rate.verdict) == ("rate", "1000.0 Hz", "ok")
    film.silent = True
    reason = r"no sample came from the sensor in 0\.1 s: it is unplugged"
    with pytest.raises(BenchError, match=reason):
        listen(film, 0.1)


def serial(baud: int, **keys: str) -> TmclScene:
    return tmcl_scene(port="/dev/ttyACM0", baud=baud, **keys)


def test_a_command_occupies_the_line_for_its_bits_with_all_stuffing() -> None:
    assert serial(115_200).exchange_s / 2 == pytest.approx(0.78e-3, abs=2e-6)
    assert serial(9_600).exchange_s / 2 == pytest.approx(9.4e-3, abs=3e-5)
    assert (can_frame_bits(0), can_frame_bits(8)) == (55, 135)
    bus = {"interface": "virtual", "channel": "0", "bitrate": "1 Mbit/s"}
    assert tmcl_scene(**bus).exchange_s == pytest.approx(250e-6)
    cia402 = Cia402Scene.model_validate({"kind": "cia402", **bus})
    assert cia402.exchange_s == pytest.approx(410e-6)


@pytest.mark.parametrize(
    ("scene", "verdict"),
    [
        (serial(1_000_000), "ok"),
        (serial(115_200), "warn"),
        (serial(9_600), "fail"),
        (serial(9_600, period="20 ms", watchdog="80 ms"), "warn"),
    ],
)
def test_the_command_rate_that_the_line_allows_is_judged(scene: TmclScene, verdict: str) -> None:
    check = check_line(scene, 1e-3)
    assert check.verdict == verdict
    assert f"at most {1 / scene.exchange_s:.0f} commands a second" in check.text
    assert bool(check.reason) == (verdict != "ok")
