"""The sketch on a simulated chip and compiled for this machine: the same states, ms by ms.

Commands reach the chip 0.1 ms after its millisecond begins, and this machine's board before it.
"""

import random
from collections.abc import Iterable
from contextlib import closing

import pytest

from pulse_drives.stepdir.frames import (
    BoardGreeting,
    BoardLimits,
    BoardReport,
    BoardState,
    Format,
    HomeSearch,
    StateFlag,
    board_reader,
    decode_report,
    encode_command,
)
from telepulse.emulators.sketch import Sketch
from tests.support import simavr
from tests.support.avr_boards import Display
from tests.support.simavr import Programs

pytestmark = pytest.mark.skipif(simavr.missing() is not None, reason=str(simavr.missing()))

# The tip is where the count is: the motor would move by ticks of another phase.
SETTINGS = {"rigid": 1.0, "film_noise_v": 0.0}
USUAL = BoardLimits(0, 4_000, 10_000_000, 32_000, 500, 13_000, 3_000, 16_000, 50, 0)
SLOW = USUAL._replace(acceleration=123_456, withdrawal=777, withdrawal_rate=4_321, options=4)
SEARCH = HomeSearch(8_000, 6_000, 500, 3_000)
STARTED_MS = 5
# Rates take effect a tick earlier or later, which at the highest rate and acceleration is a step or
# more at each change, and at a bound of position changes the rate.
APART_STEPS = {"no home": 0, "withdrawn while homing": 2}
MOST_APART_STEPS, MOST_APART_RATE = 32, 3_000 * 256
# What is found in a millisecond may be found in another, where a step comes at its end.
APART_MS = 2
AT_BOUND = StateFlag.AT_LOWEST | StateFlag.AT_HIGHEST
# The chip takes some 0.15 ms for a command of 37 bytes, and its clock begins before its timer.
APART_US = 200
# (at ms, command or setting of the board, its values)
Script = list[tuple[int, Format | str, tuple[float, ...]]]


def begun(limits: BoardLimits, search: HomeSearch, alive_ms: int = 680) -> Script:
    """Return the commands that home a board, which is shown for some time that its host lives."""
    return [
        (6, Format.GREET, ()), (8, Format.ARM, ()), (9, Format.LIMITS, tuple(limits)),
        (11, Format.ARM, ()), (13, Format.HOME, tuple(search)),
        *((at_ms, Format.VELOCITY, (0, 20)) for at_ms in range(15, alive_ms, 20)),
    ]  # fmt: skip


def driven(seed: int, from_ms: int, until_ms: int) -> Script:
    """Return velocities at random, with silences that the board brakes in."""
    chance, now_ms, script = random.Random(seed), from_ms, Script()
    while (now_ms := now_ms + chance.choice((1, 2, 2, 7, 30))) < until_ms:
        rate = chance.choice((0, 100.5, 333, 1_000, 4_999.75, 20_000, 32_000, 40_000))
        velocity = round(chance.choice((-1, 1)) * rate * 256)
        script.append((now_ms, Format.VELOCITY, (velocity, chance.choice((5, 20)))))
    return script


SCRIPTS: dict[str, Script] = {
    "silence": [*begun(USUAL, SEARCH), *driven(1, 700, 1_500)],
    "film": [
        *begun(USUAL, SEARCH), *driven(2, 700, 1_000), (1_000, "film_v", (0.1,)),
        (1_200, Format.HOME, SEARCH), (1_210, Format.CLEAR, ()), (1_220, Format.ARM, ()),
        (1_222, Format.HOME, SEARCH),
    ],
    "fault pin, slow": [
        *begun(SLOW, SEARCH._replace(rate=3_999), 1_580), *driven(3, 1_600, 2_000),
        (2_000, "fault", (1,)), (2_300, Format.VELOCITY, (256_000, 20)),
    ],
    "switch": [
        *begun(USUAL, SEARCH),
        *((700 + 2 * n, Format.VELOCITY, (2_000_000, 20)) for n in range(99)),
        (850, "stuck_switch", (1,)),
    ],
    "withdrawn while homing": [
        *begun(SLOW, SEARCH, 99), (100, Format.WITHDRAW, ()), (110, Format.DISARM, ()),
        (115, Format.LIMITS, SLOW._replace(lowest=7, highest=7)), (120, Format.ARM, ()),
        (130, Format.WITHDRAW, ()), (400, Format.DISARM, ()),
    ],
    "no home": [*begun(USUAL, SEARCH._replace(distance=500), 200)],
    "home here": [*begun(USUAL, HomeSearch(0, 0, 1, 1), 18), *driven(4, 20, 600)],
}  # fmt: skip


class ChipBoard:
    """The sketch on a simulated chip, 0.1 ms late."""

    def __init__(self, programs: Programs) -> None:
        self._display = Display(programs, *(f"{name}={value}" for name, value in SETTINGS.items()))
        self._display.run(STARTED_MS + 0.1)

    def set(self, name: str, value: float) -> None:
        # Low is a fault.
        line = {"film_v": f"film {value}", "stuck_switch": f"switch {value:g}"}
        self._display.tell(line.get(name, f"fault {1 - value:g}"))

    def write(self, data: bytes) -> None:
        self._display.write(data)

    def run(self, ms: int) -> None:
        self._display.run(ms)

    def reports(self) -> tuple[list[BoardState], list[BoardReport]]:
        return self._display.states, self._display.others

    def close(self) -> None:
        self._display.close()


class NativeBoard:
    """The sketch on this machine."""

    def __init__(self) -> None:
        self._sketch, self._reader = Sketch(fault_pin=1, **SETTINGS), board_reader()
        self._sketch.power_up()
        self._reports: list[BoardReport] = []
        self.run(STARTED_MS)

    def set(self, name: str, value: float) -> None:
        self._sketch.set(**{name: value})

    def write(self, data: bytes) -> None:
        assert self._sketch.feed(data) == len(data)

    def run(self, ms: int) -> None:
        for _ in range(ms):
            self._sketch.run(1)
            decoded = map(decode_report, self._reader.feed(self._sketch.take()))
            self._reports += [report for report in decoded if report is not None]

    def reports(self) -> tuple[list[BoardState], list[BoardReport]]:
        states = [each for each in self._reports if isinstance(each, BoardState)]
        return states, [each for each in self._reports if not isinstance(each, BoardState)]

    def close(self) -> None:
        pass


def play(board: ChipBoard | NativeBoard, script: Script) -> None:
    now_ms = STARTED_MS
    for number, (at_ms, what, values) in enumerate(script, 1):
        board.run(at_ms - now_ms)
        now_ms = at_ms
        if isinstance(what, Format):
            board.write(encode_command(what, number, tuple(map(int, values))))
        else:
            board.set(what, *values)
    board.run(500)


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Programs:
    """Compile harness and sketch."""
    return Programs.compile(tmp_path_factory.mktemp("board"))


def is_between(value: int, others: Iterable[int], apart: int) -> bool:
    return min(others) - apart <= value <= max(others) + apart


@pytest.mark.parametrize("name", SCRIPTS)
def test_chip_and_machine_take_the_same_steps(name: str, programs: Programs) -> None:
    native = NativeBoard()
    play(native, SCRIPTS[name])
    with closing(ChipBoard(programs)) as chip:
        play(chip, SCRIPTS[name])
    (of_native, ours), (of_chip, its) = native.reports(), chip.reports()
    greeting, *answers = its
    assert isinstance(greeting, BoardGreeting)
    assert [greeting._replace(name="emulated"), *answers] == ours
    assert len(of_chip) == pytest.approx(len(of_native), abs=1)
    steps = APART_STEPS.get(name, MOST_APART_STEPS)
    rate = MOST_APART_RATE if steps else 0
    for number, state in enumerate(of_chip[:-1]):
        there = of_native[number]
        assert state.counter == there.counter
        assert 0 <= state.time_us - there.time_us <= APART_US
        near = of_native[max(0, number - APART_MS) : number + APART_MS + 1]
        assert is_between(state.position, [each.position for each in near], steps), near
        assert is_between(state.velocity, [each.velocity for each in near], rate), near
        assert is_between(state.film, [each.film for each in near], 0), near
        assert (state.mode, state.cause) in [(each.mode, each.cause) for each in near], near
        assert state.sequence in [each.sequence for each in near], near
        assert state.flags | AT_BOUND in [each.flags | AT_BOUND for each in near], near
