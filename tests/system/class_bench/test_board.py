"""The finger's board alone: its sketch on an emulated ATmega328P, at a motor, a screw and a finger.

Time passes on command, so nothing here depends on this machine's speed.
"""

import os
import random
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from pulse_drives.stepdir.frames import (
    BoardLimits,
    BoardMode,
    BoardState,
    CommandResult,
    Format,
    HomeSearch,
    StateFlag,
    TripCause,
)
from pulse_drives.stepdir.scene import PER_STEP_RATE
from tests.support import simavr
from tests.support.avr_boards import Display
from tests.support.class_bench import TICK_HZ, given_steps
from tests.support.simavr import Harness, Programs

pytestmark = pytest.mark.skipif(simavr.missing() is not None, reason=str(simavr.missing()))

DISARMED, ARMED, HOMING, READY, RUNNING, WITHDRAWING, WITHDRAWN, FAULT = BoardMode
DONE, WRONG_STATE, OUT_OF_BOUNDS, UNKNOWN, NO_LIMITS, FILM_OUTSIDE = CommandResult
NONE, SILENCE, FILM, FAULT_PIN, HOST, RESET, SWITCH, NO_HOME, STUCK, TIMEOUT, PRESSED = TripCause
HOMED, AT_HOME, AT_LOWEST, AT_HIGHEST, FAULTY, OUTSIDE, HAS_LIMITS, ON, EXPIRED = StateFlag
STATE, VELOCITY, HOME, LIMITS = Format.STATE, Format.VELOCITY, Format.HOME, Format.LIMITS
ARM, DISARM, CLEAR, WITHDRAW = Format.ARM, Format.DISARM, Format.CLEAR, Format.WITHDRAW
FULL_SCALE = 16_368
STEP_M = 2e-3 / 200 / 16
USUAL = BoardLimits(0, 4_000, 10_000_000, TICK_HZ, 500, 13_000, 3_000, 16_000, 50, 0)
SEARCH = HomeSearch(8_000, 6_000, 500, 3_000)
HERE = HomeSearch(0, 0, 1, 1)
# First touch is at this position, as home is 2 mm before it and the switch opens a little later.
TOUCH = 3_200
Open = Callable[..., AbstractContextManager[Display]]


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Programs:
    """Compile harness and sketch."""
    return Programs.compile(tmp_path_factory.mktemp("board"))


@pytest.fixture
def board(programs: Programs) -> Open:
    """Return a function that starts a board, after power-up."""

    @contextmanager
    def start(*settings: str) -> Iterator[Display]:
        with closing(Display(programs, *settings)) as display:
            display.run(10)
            yield display

    return start


def arm(display: Display, **limits: int) -> None:
    assert display.ask(LIMITS, *USUAL._replace(**limits)) == (DONE, 0)
    assert display.ask(ARM) == (DONE, 0)


def make_ready(display: Display, **limits: int) -> None:
    arm(display, **limits)
    assert display.ask(HOME, *SEARCH) == (DONE, 0)
    display.run_until(READY, alive=True)


def press(display: Display, **limits: int) -> None:
    """Press with some 0.3 N, and go on sending."""
    make_ready(display, **limits)
    display.drive(12_000, 300)
    display.drive(0, 20)
    assert 200 < display.report()["force_mn"] < 500


def left_the_finger(display: Display, within_ms: int) -> bool:
    display.run(within_ms)
    return bool(display.report()["force_mn"] == 0)


def test_power_up_leaves_the_motor_off_and_sends_a_state_each_millisecond(board: Open) -> None:
    with board() as display:
        last = display.run(500)
        counters = [state.counter for state in display.states]
        assert counters == list(range(counters[0], counters[0] + len(counters)))
        times_us = np.diff([state.time_us for state in display.states])
        assert times_us == pytest.approx(1_000, abs=50)
        assert (last.mode, last.cause, last.flags, last.position) == (DISARMED, 0, 0, 0)
        assert not display.report()["motor_on"]
        display.send(VELOCITY, 256_000, 20)
        display.run(50)
        assert display.states[-1].sequence == 0
        assert display.report()["tip_um"] == -1_000


def test_the_greeting_names_protocol_firmware_tick_film_reset_and_board(board: Open) -> None:
    with board() as display:
        assert display.greet()[1:] == (1, 257, TICK_HZ, FULL_SCALE, 1, "ATmega328P")


def test_commands_out_of_order_or_bounds_are_refused_with_the_reason(board: Open) -> None:
    least, most = -(2**28), 2**28
    wrong = {
        "lowest": (least - 1, 1),
        "highest": (0, most + 1),
        "acceleration": (999, 100_000_001),
        "highest_rate": (9, TICK_HZ + 1),
        "film_least": (13_000,),
        "film_most": (FULL_SCALE + 2,),
        "withdrawal": (0, most + 1),
        # It may last 2 s at most.
        "withdrawal_rate": (USUAL.withdrawal // 2 - 1, TICK_HZ + 1),
        "watchdog_ms": (9, 501),
        "options": (32,),
    }
    with board() as display:
        assert display.ask(ARM) == (NO_LIMITS, 0)
        for number, (name, values) in enumerate(wrong.items(), 1):
            for value in values:
                fields = USUAL._replace(**{name: value})
                assert display.ask(LIMITS, *fields) == (OUT_OF_BOUNDS, number)
        assert display.ask(HOME, *SEARCH) == (WRONG_STATE, 0)
        assert display.ask(CLEAR) == display.ask(WITHDRAW) == (WRONG_STATE, 0)
        arm(display)
        assert display.ask(LIMITS, *USUAL) == display.ask(ARM) == (WRONG_STATE, 0)
        # A search is no longer than twice the travel, its second part than half of it.
        outside = (9, TICK_HZ + 1), (8_001,), (0, 2_001), (0, 60_001)
        for number, values in enumerate(outside):
            for value in values:
                search = [*SEARCH[:number], value, *SEARCH[number + 1 :]]
                assert display.ask(HOME, *search) == (OUT_OF_BOUNDS, number + 1)
        assert display.ask(STATE) == (UNKNOWN, 0)
        # No search has shown the direction yet: the board does not move by itself.
        display.tell("film 5")
        display.run(3)
        assert display.ask(HOME, *SEARCH) == (FILM_OUTSIDE, 0)
        display.tell("reset")
        assert display.run(20).mode == DISARMED
        assert display.report()["tip_um"] == pytest.approx(-1_000, abs=1)


def test_home_is_where_the_switch_opens(board: Open) -> None:
    with board() as display:
        make_ready(display)
        state, tip_m = display.states[-1], display.report()["tip_um"] * 1e-6
        assert state.flags & (HOMED | AT_HOME) == HOMED
        # The switch is debounced for 3 ms, at an eighth of the search's speed.
        assert tip_m - state.position * STEP_M == pytest.approx(-2e-3, abs=4e-6)
    # Without a switch, home is where it is.
    with board() as display:
        arm(display)
        assert display.ask(HOME, *HERE) == (DONE, 0)
        assert (display.states[-1].mode, display.states[-1].position) == (READY, 0)
        assert display.report()["tip_um"] == pytest.approx(-1_000, abs=1)


def test_the_limits_count_from_the_first_home_until_the_motor_is_off(board: Open) -> None:
    with board() as display:
        make_ready(display, film_least=0, film_most=FULL_SCALE + 1)
        for _ in range(4):
            for search in (HERE, SEARCH):
                assert display.ask(HOME, *search) == (WRONG_STATE, 0)
            display.drive(20_000, 400)
            assert display.states[-1].position == USUAL.highest
        # Nor does the tip walk by homes of one switching-on after the other.
        for _ in range(3):
            display.ask(DISARM)
            display.run_until(DISARMED)
            arm(display, film_least=0, film_most=FULL_SCALE + 1)
            display.ask(HOME, *HERE)
            display.drive(20_000, 400)
        assert display.report()["tip_um"] == pytest.approx(500, abs=10)


@pytest.mark.parametrize("rate_hz", [100.5, 3_217.0, -9_999.0, 31_990.0])
def test_steps_come_at_the_commanded_rate_within_a_tick(
    programs: Programs, tmp_path: Path, rate_hz: float
) -> None:
    given_hz, jitter_s, lost_steps = given_steps(programs, rate_hz, tmp_path)
    assert given_hz == pytest.approx(abs(rate_hz), rel=1e-3)
    # Other interrupts delay the timer's by some 5 us.
    assert jitter_s < 1 / TICK_HZ + 10e-6
    assert lost_steps == 0


def test_the_highest_rate_loses_no_step_where_the_acceleration_is_the_motors(board: Open) -> None:
    def lost_steps(acceleration: int) -> int:
        with board("finger_n_per_m=0.001") as display:
            arm(display, lowest=-(10**6), highest=10**6, acceleration=acceleration)
            display.ask(HOME, *HERE)
            for number in range(400):
                rate = (TICK_HZ, -TICK_HZ, TICK_HZ, 0)[number // 100]
                display.send(VELOCITY, round(rate * PER_STEP_RATE), 20)
                display.run(1)
            # The board's loop keeps up: one frame each millisecond.
            counters = [state.counter for state in display.states[20:]]
            assert np.diff(counters).max() == 1
            lost: int = display.report()["lost_steps"]
            return lost

    assert lost_steps(10_000_000) == 0
    assert lost_steps(100_000_000) > 0


def test_velocity_changes_within_the_acceleration_and_ends_at_the_soft_limits(board: Open) -> None:
    with board("finger_n_per_m=0.001") as display:
        make_ready(display, acceleration=1_000_000)
        known = len(display.states)
        assert display.drive(20_000, 500).flags & AT_HIGHEST
        assert display.states[-1].position == 4_000
        assert display.drive(-20_000, 500).flags & AT_LOWEST
        states = display.states[known:]
        changes = np.diff([state.velocity / PER_STEP_RATE for state in states])
        assert np.abs(changes).max() <= 1_000
        assert max(np.abs([state.velocity / PER_STEP_RATE for state in states])) > 15_000
        positions = [state.position for state in states]
        assert (min(positions), max(positions)) == (0, 4_000)
        assert display.report()["lost_steps"] == 0


def test_a_velocity_ends_with_its_validity_and_silence_withdraws(board: Open) -> None:
    with board() as display:
        press(display)
        display.drive(1_000, 40, validity_ms=10)
        known = len(display.states)
        display.run(60)
        silent = display.states[known:]
        rested = next(state for state in silent if state.velocity == 0)
        assert rested.flags & EXPIRED
        assert rested.mode == RUNNING
        withdrawing = next(state for state in silent if state.mode == WITHDRAWING)
        assert withdrawing.cause == SILENCE
        assert 8 <= rested.counter - silent[0].counter <= 12
        assert 45 <= withdrawing.counter - silent[0].counter <= 52
        assert left_the_finger(display, within_ms=100)
        state = display.run_until(WITHDRAWN)
        # Its distance from there would be shorter.
        assert state.position == 0
        # It stays there whatever the host sends, until `clear`.
        display.drive(5_000, 50)
        assert display.states[-1].position == state.position
        assert display.ask(HOME, *SEARCH) == (WRONG_STATE, 0)
        assert display.ask(CLEAR) == (DONE, 0)
        assert display.states[-1].flags & (HOMED | ON) == 0


@pytest.mark.parametrize(("volts", "after_ms"), [(5.0, 0.1), (5.0, 0.6), (4.2, 0.9), (0.0, 0.4)])
def test_a_film_outside_its_limits_withdraws_within_2_ms(
    board: Open, volts: float, after_ms: float
) -> None:
    with board() as display:
        press(display)
        display.send(VELOCITY, 0, 500)
        display.run(2 + after_ms)
        began_um = display.report()["tip_um"]
        display.tell(f"film {volts}")
        display.run(2)
        # The state of the second millisecond is still on the line.
        state = display.run(1)
        assert (state.mode, state.cause) == (WITHDRAWING, FILM)
        assert state.velocity < 0
        assert state.flags & OUTSIDE
        assert display.report()["tip_um"] < began_um
        assert left_the_finger(display, within_ms=100)


@pytest.mark.parametrize("acceleration", [3_200_000, 10_000_000])
def test_a_motion_towards_the_finger_turns_at_once_without_a_lost_step(
    board: Open, acceleration: int
) -> None:
    with board("finger_n_per_m=0.001") as display:
        make_ready(display, highest=60_000, acceleration=acceleration)
        display.drive(TICK_HZ, 200)
        display.tell("film 5")
        state = display.run_until(WITHDRAWING)
        stopped_um = display.report()["tip_um"]
        assert state.velocity <= 0
        display.run(5)
        assert display.states[-1].velocity < 0
        assert display.report()["tip_um"] < stopped_um
        display.run_until(WITHDRAWN)
        assert display.report()["lost_steps"] == 0


def test_a_fault_of_the_carrier_and_the_hosts_command_withdraw(board: Open) -> None:
    with board() as display:
        press(display, options=4)
        display.tell("fault 0")
        display.drive(0, 6)
        assert (display.states[-1].mode, display.states[-1].cause) == (WITHDRAWING, FAULT_PIN)
        display.run_until(WITHDRAWN)
        assert display.ask(CLEAR) == (DONE, 0)
        display.tell("fault 1")
        # Not homed, it knows no way off the finger.
        arm(display)
        assert display.ask(WITHDRAW) == (WRONG_STATE, 0)
        assert display.ask(HOME, *HERE) == display.ask(WITHDRAW) == (DONE, 0)
        assert display.run_until(WITHDRAWN).cause == HOST


def test_garbage_is_counted_and_harmless(board: Open) -> None:
    noise = random.Random(1)
    with board() as display:
        make_ready(display)
        for _ in range(50):
            display.drive(0, 4)
            display.write(noise.randbytes(60))
        display.drive(0, 4)
        display.write(b"\1" * 1_000 + b"\0")
        for _ in range(50):
            display.drive(0, 4)
        state = display.states[-1]
        assert (state.mode, state.cause) == (RUNNING, 0)
        assert state.rejected > 50
        assert abs(state.position) < 100
        assert display.spoilt == 0
        # Answers to limits, arm and home only.
        assert len(display.others) == 3
        # Silence with garbage on the line is silence.
        for _ in range(30):
            display.write(noise.randbytes(20) + b"\0")
            display.run(2)
        assert display.states[-1].cause == SILENCE


def test_a_byte_that_the_simulator_loses_is_reported_as_text(
    programs: Programs, tmp_path: Path
) -> None:
    link, log = tmp_path / "line", tmp_path / "log"
    with log.open("wb") as errors, closing(Harness(programs, stderr=errors)) as harness:
        harness.open_line(link)
        line = os.open(link, os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
        until_s = time.monotonic() + 20
        while log.stat().st_size < 100 and time.monotonic() < until_s:
            with suppress(BlockingIOError):
                os.write(line, b"\xc8" * 64)
            time.sleep(0.0005)
        os.close(line)
    assert "lost char=?=0xC8" in log.read_text("utf-8")


def test_a_reset_of_a_pressing_board_withdraws_without_a_host(board: Open) -> None:
    with board() as display:
        press(display)
        display.tell("reset 50")
        assert left_the_finger(display, within_ms=200)
        state = display.run_until(WITHDRAWN)
        assert state.cause == RESET
        assert not state.flags & (HOMED | HAS_LIMITS)
        assert display.greet().reset_cause == 2
        assert display.ask(ARM) == (NO_LIMITS, 0)
        # Withdrawn or never armed, it stays where it is.
        display.tell("reset")
        state = display.run(100)
        assert (state.mode, state.cause, state.position) == (DISARMED, 0, 0)


@pytest.mark.parametrize("stuck", [False, True])
def test_a_reset_at_any_time_of_a_withdrawal_continues_it(board: Open, stuck: bool) -> None:
    with board() as display:
        press(display)
        if stuck:
            # One that claims home where the position cannot be home ends nothing.
            display.tell("switch 1")
        for _ in range(4):
            display.tell("reset")
            display.run(8)
        assert display.states[-1].mode == WITHDRAWING
        state = display.run_until(WITHDRAWN)
        report = display.report()
        assert (state.cause, report["force_mn"], report["motor_on"]) == (RESET, 0, 1)
        # Home by the position that was kept; the motor turns to a full step when it is switched on.
        assert -2_300 < report["tip_um"] < -1_900


def test_an_unplugged_cable_withdraws(board: Open) -> None:
    with board() as display:
        press(display)
        display.tell("unplug")
        display.pass_time(150)
        assert display.report()["force_mn"] == 0


def test_a_program_that_hangs_is_reset_by_the_processors_watchdog(
    board: Open, programs: Programs, tmp_path: Path
) -> None:
    command = ["avr-nm", str(programs.firmware)]
    symbols = subprocess.run(command, capture_output=True, encoding="utf-8", check=True).stdout
    (endless,) = (line.split()[0] for line in symbols.splitlines() if "__stop_program" in line)
    trace = tmp_path / "trace.csv"
    with board(f"trace={trace}") as display:
        make_ready(display)
        display.drive(16_000, 240)
        assert display.states[-1].position > 3_600
        display.tell(f"hang {int(endless, 16)}")
        assert left_the_finger(display, within_ms=200)
        assert display.run_until(WITHDRAWN).cause == RESET
        assert display.greet().reset_cause == 4
        # Home, as the steps that were given meanwhile count.
        assert display.report()["tip_um"] == pytest.approx(-2_000, abs=40)
    # Without the loop, the interrupt gives no step beyond the soft limit.
    rows = [row.split(",") for row in trace.read_text().splitlines() if row.startswith("ms")]
    assert max(float(row[2]) for row in rows) < 4_000 * STEP_M * 1e6 - 2_000 + 15


def test_a_home_switch_that_is_stuck_fails_the_search_or_withdraws(board: Open) -> None:
    # The second part of a search is towards the finger, and is undone.
    for level, cause, moved_steps in ((0, NO_HOME, -6_000), (1, STUCK, 0)):
        with board() as display:
            arm(display)
            display.tell(f"switch {level}")
            display.run(5)
            began_um = display.report()["tip_um"]
            display.ask(HOME, *SEARCH)
            state, report = display.run_until(FAULT, alive=True), display.report()
            assert (state.cause, state.flags & HOMED, report["motor_on"]) == (cause, 0, 0)
            moved_um = report["tip_um"] - began_um
            assert moved_um == pytest.approx(moved_steps * STEP_M * 1e6, abs=20)
    with board() as display:
        arm(display)
        display.ask(HOME, 100, 6_000, 500, 200)
        assert display.run_until(FAULT, alive=True).cause == TIMEOUT
    with board() as display:
        press(display)
        display.tell("switch 1")
        display.drive(0, 10)
        assert (display.states[-1].mode, display.states[-1].cause) == (WITHDRAWING, SWITCH)
        assert left_the_finger(display, within_ms=100)
        # The switch does not end it before home.
        assert display.run_until(WITHDRAWN).position == 0


def test_the_switch_is_read_anew_with_the_limits_and_after_it_bounced(board: Open) -> None:
    with board() as display:
        # Closed, as a board reads it that does not know the wiring; and open at a closed contact.
        display.tell("switch 1")
        display.run(10)
        for command in ((LIMITS, *USUAL._replace(options=2)), (ARM,), (HOME, *SEARCH)):
            display.send(*command)
        assert display.run(10).mode == HOMING
        assert display.states[-1].position < 0
    with board() as display:
        for closed_ms in range(2, 7):
            display.tell("switch 1")
            display.run(closed_ms)
            display.tell("switch ok")
            assert not display.run(8).flags & AT_HOME


def test_silence_withdraws_in_ready_too(board: Open) -> None:
    with board("start_mm=0.25") as display:
        arm(display)
        assert display.ask(HOME, *HERE) == (DONE, 0)
        assert display.run(40).mode == READY
        assert display.report()["force_mn"] > 200
        state = display.run_until(WITHDRAWN, 400)
        # From where home was, by its distance.
        assert (state.cause, state.position) == (SILENCE, -USUAL.withdrawal)
        assert display.report()["force_mn"] == 0


def test_an_armed_board_without_a_host_switches_its_motor_off(board: Open) -> None:
    with board() as display:
        arm(display)
        assert display.run(900).mode == ARMED
        state = display.run(200)
        assert (state.mode, state.cause, state.flags & ON) == (FAULT, SILENCE, 0)


def test_a_disarmed_board_takes_the_tip_home_before(board: Open) -> None:
    with board() as display:
        press(display)
        assert display.ask(DISARM) == (DONE, 0)
        assert display.states[-1].mode == WITHDRAWING
        assert display.ask(LIMITS, *USUAL) == (WRONG_STATE, 0)
        state, report = display.run_until(DISARMED), display.report()
        assert (state.position, report["force_mn"], report["motor_on"]) == (0, 0, 0)
    with board() as display:
        # After a trip it goes on as far as without.
        press(display)
        display.tell("film 5")
        display.run_until(WITHDRAWING)
        assert display.ask(DISARM) == (DONE, 0)
        assert display.run_until(DISARMED).position == 0
        # At home, and while it is not homed, it moves no further.
        arm(display)
        assert display.ask(DISARM) == (DONE, 0)
        assert display.states[-1].mode == DISARMED


TRIPS = {
    "torn film": ("film 0", FILM),
    "film at full scale": ("film 5", FILM),
    "bad contact": ("film 1.9", FILM),
    "fault pin": ("fault 0", FAULT_PIN),
    "host": (WITHDRAW, HOST),
    "silence": (None, SILENCE),
}


def trip(display: Display, what: str | Format | None) -> BoardState:
    """Let something end a search; return the state at the end."""
    if isinstance(what, Format):
        display.send(what)
    elif what is not None:
        display.tell(what)
    for _ in range(3_000):
        state = display.run(1)
        if state.mode not in (HOMING, WITHDRAWING):
            return state
        if what is not None:
            display.send(VELOCITY, 0, 20)
    raise AssertionError(f"the search goes on: {state}")


@pytest.mark.parametrize(("what", "cause"), TRIPS.values(), ids=TRIPS)
@pytest.mark.parametrize("began_mm", [0.4, 0.1, -1.0])
def test_a_search_that_trips_never_leaves_more_force_than_it_found(
    board: Open, what: str | Format | None, cause: TripCause, began_mm: float
) -> None:
    """It begins pressed, as after a loss of the supply, or slightly, or off the finger."""
    for searched_ms in (3, 60, 130):
        with board(f"start_mm={began_mm}") as display:
            arm(display, options=4)
            display.ask(HOME, *SEARCH)
            for _ in range(0, searched_ms, 3):
                display.send(VELOCITY, 0, 20)
                display.run(3)
            before = display.report()
            state, after = trip(display, what), display.report()
            assert state.cause is cause
            assert after["force_mn"] <= before["force_mn"]
            assert after["tip_um"] <= before["tip_um"] + 1
            # Silence is found 50 ms later.
            if began_mm == 0.4 and (before["force_mn"] < 200 or what is None):
                assert (state.mode, after["force_mn"]) == (WITHDRAWN, 0)
            else:
                # The board cannot know the direction.
                assert (state.mode, after["motor_on"]) == (FAULT, 0)


@pytest.mark.parametrize("falls", [False, True])
def test_a_search_that_presses_goes_back_to_where_it_began(board: Open, falls: bool) -> None:
    film = "film_v_per_n=-0.51" if falls else "film_v_per_n=0.51"
    with board(film) as display:
        arm(display, options=17 if falls else 1)
        display.ask(HOME, *SEARCH)
        most_mn = 0.0
        while (state := display.run(1)).mode in (HOMING, WITHDRAWING):
            display.send(VELOCITY, 0, 20)
            most_mn = max(most_mn, display.report()["force_mn"])
        assert (state.mode, state.cause, state.position) == (FAULT, PRESSED, 0)
        # A sixteenth of the film's range are 0.47 N here.
        assert 400 < most_mn < 600
        report = display.report()
        assert (report["force_mn"], report["lost_steps"]) == (0, 0)
        assert report["tip_um"] == pytest.approx(-1_000, abs=5)


@pytest.mark.parametrize("what", ["film 0", WITHDRAW, None], ids=["torn film", "host", "silence"])
def test_a_search_that_begins_to_press_goes_back_whatever_ends_it(
    board: Open, what: str | Format | None
) -> None:
    with board("start_mm=-0.1") as display:
        arm(display, options=1)
        display.ask(HOME, *SEARCH)
        while display.report()["force_mn"] < 250:
            display.send(VELOCITY, 0, 20)
            display.run(1)
        state = trip(display, what)
        assert (state.mode, state.position, display.report()["force_mn"]) == (FAULT, 0, 0)


def test_the_second_part_of_a_search_presses_no_finger(board: Open) -> None:
    for began_mm in (0.0, 0.3):
        with board(f"start_mm={began_mm}") as display:
            display.tell("switch 1")
            display.run(5)
            began = display.report()
            arm(display)
            display.ask(HOME, *SEARCH._replace(opening=2_000))
            state = display.run_until(FAULT, alive=True)
            assert state.cause == PRESSED
            after = display.report()
            assert after["force_mn"] <= began["force_mn"] + 1
            assert not after["motor_on"]
