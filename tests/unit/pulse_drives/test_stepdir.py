"""A display board on its line, in virtual time: version, limits, faults, withdrawal, film."""

from collections import Counter
from collections.abc import Iterator
from contextlib import closing

import pytest

from display_node.hardware import build_display_drive
from protocol.config.scene import validate
from protocol.errors import DriveError, SceneError, SourceError
from pulse_drives.stepdir.drive import StepdirDrive
from pulse_drives.stepdir.frames import (
    SEQUENCE_TURN,
    BoardMode,
    Format,
    LimitOption,
    TripCause,
)
from pulse_drives.stepdir.line import BoardLine
from pulse_drives.withdrawal import WithdrawalOutcome
from pulse_sensors.binary_frames import FrameEncoder
from pulse_sensors.drive_film import DriveFilmDecoder, DriveFilmScene
from pulse_sensors.sensor import Sensor
from tests.support.drive_benches import (
    FORCE_LIMIT_N,
    LAYER,
    Bench,
    actuator_of,
    stepdir_scene,
    stepper,
    virtual_bench,
)
from tests.support.fault_injection import FaultKind, InjectedFault

RATE_HZ = 400.0
FILM = DriveFilmScene.model_validate({"kind": "drive", "zero": 8000, "newtons_per_count": 5e-4})
MS = 1_000_000
SENSOR = ("pulse_sensors.sensor",)


@pytest.fixture
def bench() -> Iterator[Bench]:
    with virtual_bench("stepdir") as bench:
        yield bench


def stall(bench: Bench, ms: int) -> None:
    """Stop all threads of the host, as SIGSTOP or its end does."""
    bench.clock.stall(list(bench.clock.threads), bench.clock.now_ns + ms * MS)
    bench.clock.run(bench.clock.now_ns + ms * MS)


@pytest.mark.parametrize(
    ("protocol", "firmware", "words"),
    [
        (1, 0x0100, r"firmware 1\.0 has protocol 1, and protocol 1 of firmware 1\.1 .* update it"),
        (0, 0x0100, r"firmware 1\.0 has protocol 0.* update it: arduino-cli .*telepulse_display"),
        (1, 0x0003, r"firmware 0\.3 .* update it: arduino-cli compile --upload .*--port virtual"),
        (2, 0x0200, r"firmware 2\.0 has protocol 2.* update telepulse"),
    ],
)
def test_a_board_of_another_version_is_refused(
    bench: Bench, protocol: int, firmware: int, words: str
) -> None:
    bench.emulator.versions = {"protocol": protocol, "firmware": firmware}
    with pytest.raises(DriveError, match=words) as error:
        bench.drive.start()
    assert error.value.kind == "refused"
    assert bench.emulator.mode is BoardMode.DISARMED


def test_a_motor_faster_than_the_board_steps_is_refused() -> None:
    with (
        virtual_bench("stepdir", stepper(max_speed="30 mm/s")) as bench,
        pytest.raises(DriveError, match=r"32000 /s: set max_speed to at most 20 mm/s"),
    ):
        bench.drive.start()


def test_the_limits_of_the_scene_are_in_the_board_before_its_motor_is_on() -> None:
    keys = {"inverted": True, "home_switch": "normally_closed", "fault_pin": "high"}
    with virtual_bench("stepdir", touch="2 mm", watchdog="80 ms", **keys) as bench:
        assert isinstance(bench.drive, StepdirDrive)
        bench.drive.film_port(*FILM.counts_within(2.7))
        bench.start()
        limits, step_m = bench.emulator.limits, bench.actuator.step_m
        assert limits.lowest == 0
        assert limits.highest * step_m == pytest.approx(4.5e-3, abs=0.3e-3)
        assert limits.acceleration == pytest.approx(20.0 / step_m)
        assert limits.highest_rate == limits.withdrawal_rate == 32_000
        assert (limits.film_least, limits.film_most) == (8000 - 5400, 8000 + 5400)
        # The whole travel beyond first touch, and 0.5 mm.
        assert limits.withdrawal * step_m == pytest.approx(limits.highest * step_m - 1.5e-3)
        assert (limits.watchdog_ms, limits.options) == (80, 0b1111)


def test_a_hard_limit_beyond_the_films_range_is_the_end_of_the_range(bench: Bench) -> None:
    assert isinstance(bench.drive, StepdirDrive)
    bench.drive.film_port(*FILM.counts_within(100.0))
    bench.start()
    limits = bench.emulator.limits
    assert (limits.film_least, limits.film_most) == (0, 16_368)


def test_a_film_that_counts_down_is_known_to_the_board(bench: Bench) -> None:
    assert isinstance(bench.drive, StepdirDrive)
    film = FILM.model_copy(update={"newtons_per_count": -5e-4})
    bench.drive.film_port(*film.counts_within(2.7))
    bench.start()
    limits = bench.emulator.limits
    assert (limits.film_least, limits.film_most) == (8000 - 5400, 8000 + 5400)
    assert limits.options & LimitOption.FILM_FALLS


@pytest.mark.parametrize("zero", [81_840, 20_000, -9_000])
def test_a_film_whose_hard_limits_the_converter_never_reaches_is_refused(
    bench: Bench, zero: float
) -> None:
    assert isinstance(bench.drive, StepdirDrive)
    bench.drive.film_port(zero - 3_600, zero + 3_600)
    with pytest.raises(
        DriveError, match=r"hard limits .* converter counts 0 to 16368: correct zero"
    ) as error:
        bench.drive.start()
    assert error.value.kind == "refused"
    assert bench.emulator.mode is BoardMode.DISARMED


def test_a_zero_that_no_board_counts_to_is_refused_with_its_scene() -> None:
    keys = {"kind": "drive", "zero": 81_840, "newtons_per_count": 5e-4}
    with pytest.raises(SceneError, match=r"feedback zero = 81840 .* 32767: give the counts"):
        validate(keys, DriveFilmScene, "[display] feedback")


def test_an_old_answer_is_none_to_a_command_of_the_same_number(bench: Bench) -> None:
    line = BoardLine(stepdir_scene(port="virtual"), Counter())
    line.attach()
    assert line.request(Format.CLEAR) is not None
    # Commands are numbered in turn, whether the port takes them or not.
    bench.line.full = True
    for _ in range(SEQUENCE_TURN - 1):
        line.send(Format.CLEAR)
    bench.line.full = False
    bench.emulator.trouble = "silent"
    with pytest.raises(DriveError, match="no answer to clear"):
        line.request(Format.CLEAR)
    line.detach()


def test_a_host_that_stalls_in_a_search_ends_it(bench: Bench) -> None:
    stalled = False

    def stalls() -> None:
        nonlocal stalled
        if bench.emulator.mode is BoardMode.HOMING and not stalled:
            stalled = True
            bench.clock.stall(list(bench.clock.threads), bench.clock.now_ns + 100 * MS)

    bench.clock.every(MS, stalls)
    with pytest.raises(DriveError, match="no velocity came in time") as error:
        bench.start()
    assert error.value.kind == "not homed"
    assert bench.emulator.mode is BoardMode.DISARMED


def test_a_board_in_its_bootloader_is_waited_for(bench: Bench) -> None:
    bench.emulator.trouble = "silent"
    ready_ns = bench.clock.now_ns + 1_500 * MS
    bench.clock.at(ready_ns, lambda: setattr(bench.emulator, "trouble", ""))
    bench.start(RATE_HZ)
    assert bench.fault == ""


def test_a_board_that_stays_silent_is_no_answer(bench: Bench) -> None:
    bench.emulator.trouble = "silent"
    with pytest.raises(DriveError, match="no greeting within 4 s") as error:
        bench.drive.start()
    assert error.value.kind == "no answer"


def test_a_sensors_board_on_the_port_is_named(bench: Bench) -> None:
    frames = FrameEncoder("int16").frame([1, 2, 3, 4], 4_000) * 2
    bench.emulator.trouble = "silent"
    bench.clock.every(4 * MS, lambda: bench.line.frames.write(frames))
    with pytest.raises(DriveError, match="this is a sensor's board, not the display's"):
        bench.drive.start()


def test_a_drive_at_first_touch_may_wait_for_the_loop(bench: Bench) -> None:
    bench.start()
    bench.clock.sleep(3.0)
    assert bench.fault == ""
    bench.keep(RATE_HZ, lambda: bench.motor.tip_m > 0.05e-3)


@pytest.mark.parametrize(
    ("trouble", "named"), [("silent", "no answer for 5"), ("garbled", "garbled for 5")]
)
def test_states_that_do_not_come_are_a_fault(bench: Bench, trouble: str, named: str) -> None:
    bench.start(RATE_HZ, 0.05e-3)
    bench.emulator.trouble = trouble
    bench.keep(RATE_HZ, lambda: bench.fault)
    assert bench.fault.startswith(named)
    # The board receives the withdrawal all the same.
    bench.wait(lambda: bench.at_rest and bench.motor.tip_m < 0)
    bench.emulator.trouble = ""
    bench.start()
    assert bench.fault == ""


def test_single_bad_frames_are_only_counted(bench: Bench) -> None:
    bench.start(RATE_HZ)
    for trouble in ("garbled", "silent"):
        bench.emulator.trouble = trouble
        until_ns = bench.clock.now_ns + 10 * MS
        bench.keep(RATE_HZ / 10, lambda end=until_ns: bench.clock.now_ns >= end)
        bench.emulator.trouble = ""
        until_ns = bench.clock.now_ns + 10 * MS
        bench.keep(0.0, lambda end=until_ns: bench.clock.now_ns >= end)
    assert bench.fault == ""
    garbled, missed = bench.drive.counts["garbled"], bench.drive.counts["missed"]
    assert garbled == pytest.approx(10, abs=1)
    assert missed - garbled == pytest.approx(10, abs=1)


def test_frames_that_the_board_cannot_read_are_counted(bench: Bench) -> None:
    bench.start(RATE_HZ)
    for _ in range(3):
        bench.line.write(b"\x05noise\x00")
    bench.keep(0.0, lambda: bench.drive.counts["unread"])
    bench.keep(0.0, lambda: bench.at_rest)
    assert bench.drive.counts["unread"] == 3
    assert bench.fault == ""


def test_a_port_that_takes_no_bytes_never_delays_a_command(bench: Bench) -> None:
    bench.start(RATE_HZ)
    bench.line.full = True
    began_ns = bench.clock.now_ns
    for _ in range(5):
        bench.drive.command(RATE_HZ * bench.actuator.step_m)
    assert bench.clock.now_ns == began_ns
    assert bench.drive.counts["superseded"] == 5
    bench.line.full = False
    bench.keep(-RATE_HZ, lambda: bench.motor.rate_hz < 0)
    assert bench.fault == ""


def test_a_part_of_a_frame_that_the_port_has_taken_is_completed(bench: Bench) -> None:
    bench.start(RATE_HZ)
    write = bench.line.write
    bench.line.write = lambda data: write(data[:5])
    bench.drive.command(RATE_HZ * bench.actuator.step_m)
    bench.line.write = write
    bench.keep(-RATE_HZ, lambda: bench.motor.rate_hz < 0)
    assert bench.drive.counts["unread"] == 0


@pytest.mark.parametrize("event", ["the host stops", "unplugged", "reset"])
def test_the_board_takes_the_tip_off_the_finger_by_itself(bench: Bench, event: str) -> None:
    bench.start(RATE_HZ, 0.3e-3)
    assert bench.motor.force_n > 0.1
    match event:
        case "reset":
            bench.emulator.restart()
        case "unplugged":
            bench.line.unplugged = True
    stall(bench, 300)
    assert bench.emulator.mode is BoardMode.WITHDRAWN
    assert bench.motor.force_n == 0.0
    assert bench.motor.tip_m < 0
    bench.keep(RATE_HZ, lambda: bench.fault)
    assert bench.at_rest


def test_a_board_that_was_reset_is_a_fault_and_can_be_started_again(bench: Bench) -> None:
    bench.start(RATE_HZ, 0.1e-3)
    bench.emulator.restart()
    bench.keep(RATE_HZ, lambda: bench.fault)
    assert bench.fault == "it was reset"
    # Its withdrawal ends before the board is set up again.
    bench.start(RATE_HZ, 0.05e-3)
    assert bench.fault == ""


def test_the_boards_hard_limit_of_the_film_needs_no_host() -> None:
    with virtual_bench("stepdir", film=FILM) as bench:
        assert isinstance(bench.drive, StepdirDrive)
        bench.drive.film_port(*FILM.counts_within(0.5))
        bench.start(8 * RATE_HZ, 0.1e-3)
        most_n = 0.0

        def watch() -> None:
            nonlocal most_n
            most_n = max(most_n, bench.motor.force_n)

        bench.clock.every(MS, watch)
        bench.keep(8 * RATE_HZ, lambda: bench.fault)
        assert bench.fault == "the film is beyond its hard limits"
        # One millisecond at 2 mm/s, and the way to brake.
        assert most_n < 0.52
        bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
        bench.wait(lambda: bench.at_rest)
        assert bench.motor.force_n == 0.0


def test_the_film_comes_on_the_drives_port_in_newtons() -> None:
    with virtual_bench("stepdir", film=FILM, also=SENSOR) as bench:
        port = bench.drive.film_port(*FILM.counts_within(2.7))
        decoder = DriveFilmDecoder(FILM.period_ns)
        with closing(Sensor(port, decoder, FILM, clock=bench.clock.perf_counter_ns)) as film:
            bench.clock.sleep(0.1)
            before = [force_n for block in film.poll() for force_n in block.force_n]
            assert len(before) > 90
            assert set(before) == {0.0}
            # The board was not armed for that.
            assert bench.emulator.mode is BoardMode.DISARMED
            bench.start(RATE_HZ, 0.3e-3)
            bench.keep(0.0, lambda: bench.at_rest)
            settled_ns = bench.clock.now_ns + 50 * MS
            bench.keep(0.0, lambda: bench.clock.now_ns > settled_ns)
            force_n = film.poll()[-1].force_n[-1]
            assert force_n == pytest.approx(bench.motor.force_n, abs=5e-4)
            assert film.timestamper.missing == 0
            # The port stays open for the film.
            bench.drive.close()
            film.poll()
            bench.clock.sleep(0.1)
            assert len(film.poll()) > 0


def test_a_film_finds_its_board_again() -> None:
    with virtual_bench("stepdir", film=FILM, also=SENSOR) as bench:
        port, decoder = bench.drive.film_port(0, 1e6), DriveFilmDecoder(FILM.period_ns)
        with closing(Sensor(port, decoder, FILM, clock=bench.clock.perf_counter_ns)) as film:
            bench.clock.sleep(0.1)
            film.poll()
            bench.line.unplugged = True
            bench.clock.sleep(0.5)
            bench.emulator.restart()
            bench.line.unplugged = False
            bench.clock.sleep(0.5)
            assert film.poll()
            assert film.timestamper.restarts == 1
            (gone, *_) = film.faults()
            assert "was gone 1 time" in gone


def test_a_film_without_its_board_names_the_port_and_advice() -> None:
    scene = stepdir_scene(port="/dev/nowhere")
    drive = build_display_drive(scene, actuator_of("stepdir"), LAYER, FORCE_LIMIT_N)
    with pytest.raises(SourceError, match=r"/dev/nowhere cannot be opened.*check `port`"):
        drive.film_port(0, 1).open()


def test_another_kind_of_drive_reads_no_film() -> None:
    with virtual_bench("tmcl") as bench, pytest.raises(SceneError, match="reads no film"):
        bench.drive.film_port(0, 1)


def test_a_withdrawal_that_the_host_gives_up_is_done_by_the_board(bench: Bench) -> None:
    bench.start(RATE_HZ, 0.05e-3)
    bench.drive.withdraw()
    # From now on its positions show a motion towards the finger.
    jump = InjectedFault(FaultKind.POSITION_JUMP, 0.4e-3)
    bench.motor.injector.begin(jump, bench.clock.now_ns)
    bench.wait(lambda: bench.emulator.mode is BoardMode.WITHDRAWN)
    assert bench.motor.force_n == 0.0
    assert bench.emulator.view.cause == TripCause.HOST


def test_a_board_without_positions_is_withdrawn_and_nobody_claims_that_it_is(bench: Bench) -> None:
    bench.start(RATE_HZ, 0.05e-3)
    bench.emulator.trouble = "silent"
    bench.keep(RATE_HZ, lambda: bench.fault)
    bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.UNCONFIRMED)
    assert bench.motor.force_n == 0.0
    bench.emulator.trouble = ""
    bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)


@pytest.mark.parametrize("stalled_ms", [10, 30, 45])
def test_a_stall_shorter_than_the_watchdog_is_no_fault_at_any_speed(
    bench: Bench, stalled_ms: int
) -> None:
    """The board brakes once a velocity's validity has passed, and the host accounts for it."""
    rate_hz = 24_000.0
    bench.start(rate_hz, 0.05e-3)
    origin_m = bench.drive.travel_m(bench.clock.now_ns) - bench.motor.tip_m
    stall(bench, stalled_ms)
    travel_m = bench.drive.travel_m(bench.clock.now_ns) - origin_m
    # Beyond: a millisecond on the line and one to brake, at 15 mm/s.
    assert travel_m == pytest.approx(bench.motor.tip_m, abs=20e-6)
    until_ns = bench.clock.now_ns + 100 * MS
    bench.keep(rate_hz / 100, lambda: bench.clock.now_ns > until_ns)
    assert bench.fault == ""
