"""The finger's sketch as a library: several boards, saved states, resets, clocks, no compiler."""

import random
from itertools import pairwise

import pytest

from protocol.errors import ProcessError
from pulse_drives.stepdir.frames import (
    BoardGreeting,
    BoardLimits,
    BoardMode,
    BoardReport,
    BoardState,
    Format,
    HomeSearch,
    TripCause,
    board_reader,
    decode_report,
    encode_command,
)
from telepulse.emulators import sketch
from telepulse.emulators.sketch import Sketch

LIMITS = BoardLimits(0, 4_000, 10_000_000, 32_000, 500, 13_000, 3_000, 16_000, 50, 0)
SEARCH = HomeSearch(8_000, 6_000, 500, 3_000)
POWER_UP, RESET_PIN, BROWN_OUT, WATCHDOG = 1, 2, 3, 4
VELOCITY = 4_800 * 256
STEP_M = 0.625e-6
EVERY_RIGID = {"rigid": 1.0, "film_noise_v": 0.0}


def started(**settings: float) -> Sketch:
    board = Sketch(**settings)
    board.power_up()
    return board


def send(board: Sketch, command: Format, *fields: int) -> None:
    frame = encode_command(command, 1, fields)
    assert board.feed(frame) == len(frame)


def reports(board: Sketch, ms: int) -> list[BoardReport]:
    """Let time pass; return what the board has sent."""
    reader = board_reader()
    data = b"".join(board.run(1) or board.take() for _ in range(ms))
    return [report for report in map(decode_report, reader.feed(data)) if report is not None]


def make_ready(board: Sketch) -> None:
    send(board, Format.LIMITS, *LIMITS)
    board.run(1)
    send(board, Format.ARM)
    board.run(1)
    send(board, Format.HOME, *SEARCH)
    while board.look().state in (BoardMode.DISARMED, BoardMode.ARMED, BoardMode.HOMING):
        board.run(1)
        # A sign of life.
        send(board, Format.VELOCITY, 0, 20)
    board.run(20)


def press(board: Sketch, for_ms: int = 800) -> None:
    make_ready(board)
    for _ in range(for_ms):
        send(board, Format.VELOCITY, VELOCITY, 20)
        board.run(1)
    assert board.look().force_n > 0.3


def test_a_board_presses_and_withdraws_by_itself_when_it_hears_nothing() -> None:
    board = started()
    make_ready(board)
    ready = board.look()
    for _ in range(400):
        send(board, Format.VELOCITY, VELOCITY, 20)
        board.run(2)
    assert board.look().force_n > 0.1
    board.run(400)
    view = board.look()
    assert (view.state, view.cause) == (BoardMode.WITHDRAWN, TripCause.SILENCE)
    assert (view.force_n, view.lost_steps, view.steps_off) == (0.0, 0, 0)
    given = view.steps_in - ready.steps_in, ready.steps_out - view.steps_out
    assert view.position - ready.position == sum(given)
    # Nobody takes what it sends.
    assert view.dropped > 0


def test_a_tip_that_has_come_to_rest_at_first_touch_presses_on_from_there() -> None:
    board = started()
    make_ready(board)
    for rest_ms in range(40, 400, 9):
        while abs(depth_m := board.look().tip_m) > 0.2e-6:
            rate = max(-2_000, min(2_000, -100 * depth_m / STEP_M))
            send(board, Format.VELOCITY, round(rate * 256), 20)
            board.run(1)
        for ms in range(rest_ms + 20):
            send(board, Format.VELOCITY, 0 if ms < rest_ms else 2_000 * 256, 20)
            board.run(1)
            view = board.look()
            assert view.lost_steps == 0
            depth_m = (view.force_n / 6.285e6) ** (2 / 3) + view.force_n / 1_000
            assert depth_m == pytest.approx(max(0.0, view.tip_m), abs=1e-12)


def test_boards_of_one_library_do_not_share_their_state() -> None:
    one, other = started(), started(**EVERY_RIGID, start_mm=-1.5)
    press(one)
    alone = started()
    press(alone)
    assert other.look().state == BoardMode.DISARMED
    press(other)
    one.run(30)
    alone.run(30)
    assert one.save() == alone.save()


def test_what_follows_a_saved_state_is_always_the_same() -> None:
    board, chance = started(), random.Random(3)
    press(board, 900)
    saved = board.save()

    def go_on(seed: int) -> tuple[bytes, bytes]:
        board.restore(saved)
        chance.seed(seed)
        for _ in range(40):
            send(board, Format.VELOCITY, chance.randrange(-VELOCITY, VELOCITY), 20)
            board.run(chance.randrange(5))
        return board.take(), board.save()

    first = [go_on(seed) for seed in range(3)]
    assert len(set(first)) == 3
    assert first == [go_on(seed) for seed in range(3)]


@pytest.mark.parametrize("cause", [RESET_PIN, BROWN_OUT])
def test_a_reset_begins_anew_but_for_the_limits_that_it_keeps(cause: int) -> None:
    board = started()
    press(board)
    before = board.look()
    board.reset(cause, bootloader_ms=100)
    board.run(99)
    held = board.look()
    assert not held.motor_on
    assert (held.tip_m, held.present_ms) == (before.tip_m, 0)
    board.take()
    send(board, Format.GREET)
    (greeting,) = [each for each in reports(board, 5) if isinstance(each, BoardGreeting)]
    assert greeting.reset_cause == cause
    board.run(400)
    view = board.look()
    assert (view.state, view.cause) == (BoardMode.WITHDRAWN, TripCause.RESET)
    assert (view.homed, view.has_limits) == (0, 0)
    assert view.force_n == 0.0


def test_power_up_leaves_nothing_of_what_was() -> None:
    board = started()
    fresh = board.save()
    press(board)
    again = started()
    assert again.save() == fresh
    board.power_up()
    board.run(5)
    view = board.look()
    assert (view.state, view.motor_on, view.present_ms) == (BoardMode.DISARMED, 0, 5)


def test_a_loop_that_hangs_is_reset_by_the_watchdog_in_30_ms() -> None:
    board = started()
    press(board)
    board.set(hung=1)
    board.run(29)
    assert board.look().hangs == 0
    board.run(2)
    view = board.look()
    assert (view.hangs, view.state, view.cause) == (1, BoardMode.WITHDRAWING, TripCause.RESET)


def test_clocks_wrap() -> None:
    board = started()
    board.set_clock((1 << 32) - 2_500, (1 << 32) - 3)
    states = [each for each in reports(board, 6) if isinstance(each, BoardState)]
    assert [state.counter for state in states] == [0xFFFFFFFE, 0xFFFFFFFF, 0, 1, 2]
    times_us = [state.time_us for state in states]
    steps = [(after - before) % (1 << 32) for before, after in pairwise(times_us)]
    assert set(steps) == {1_000}
    assert min(times_us) < 2_000


def test_film_switch_and_fault_pin_are_what_a_test_sets() -> None:
    board = started(fault_pin=1)
    board.film(4_000, 3_000)
    board.set(stuck_switch=1, fault=1)
    board.run(5)
    view = board.look()
    assert (view.film, view.home_closed, view.home_pin, view.fault_pin) == (7_000, 1, 0, 0)
    board.film(-1, -1)
    board.set(stuck_switch=-1, fault=0, normally_closed=1)
    board.run(5)
    view = board.look()
    assert view.film == pytest.approx(8_184, abs=20)
    assert (view.home_pin, view.fault_pin) == (0, 1)
    with pytest.raises(KeyError, match="nothing"):
        board.set(nothing=1)


def test_without_a_compiler_one_line_names_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ProcessError, match=r"apt install g\+\+.* xcode-select --install") as error:
        sketch.compiled()
    assert "\n" not in str(error.value)
