"""The emulated display board in virtual time: its sketch, wiring, film, finger and faults."""

import numpy as np
import pytest

from display_node.plant.contact import ContactLaw
from pulse_drives.stepdir.frames import (
    BoardLimits,
    BoardMode,
    BoardState,
    CommandAnswer,
    CommandResult,
    Format,
    HomeSearch,
    LimitOption,
    StateFlag,
    TripCause,
    board_reader,
    decode_report,
    encode_command,
)
from pulse_drives.stepdir.scene import PER_STEP_RATE
from pulse_sensors.drive_film import DriveFilmScene
from sensing_node.sources.wrist import WristScene
from telepulse.emulators.motor import MotorState
from telepulse.emulators.stepdir import EmulatedBoard
from telepulse.emulators.wrist import TissueContact
from tests.support.drive_benches import LAYER, actuator_of, stepdir_scene

MS = 1_000_000
LIMITS = BoardLimits(0, 8_000, 32_000_000, 32_000, 0, 16_369, 5_000, 32_000, 50, 0)
SEARCH = HomeSearch(8_000, 9_000, 480, 10_000)
FILM = DriveFilmScene.model_validate({"kind": "drive", "zero": 8184, "newtons_per_count": 5e-4})
VELOCITY = round(4_000 * PER_STEP_RATE)
# A command takes up to a millisecond on the line, and its answer another.
ANSWERED_MS = 2
DONE, REFUSED = CommandResult.DONE, CommandResult.OUT_OF_BOUNDS


class Host:
    """The other end of a board's line; time passes only in `run`. keys: of the board's scene."""

    def __init__(
        self,
        film: DriveFilmScene | None = None,
        noise_n: float = 0.0,
        law: ContactLaw | None = None,
        **keys: object,
    ) -> None:
        scene, actuator = stepdir_scene(port="x", touch="2 mm", **keys), actuator_of("stepdir")
        law = law or actuator.contact(LAYER)
        self.board = EmulatedBoard(scene, actuator, law, film, 0, noise_n)
        self.state: BoardState | None = None
        self.now_ns = self.sequence = 0
        self._reader = board_reader()
        self._reader.feed(b"\0")

    def run(self, ms: int) -> BoardState:
        """Return the last state after some time."""
        self.now_ns += ms * MS
        self.board.receive(b"", self.now_ns)
        self._take()
        assert self.state is not None
        return self.state

    def ask(self, command: Format, *fields: int) -> CommandAnswer | None:
        """Send a command; return its answer, None without one."""
        self.sequence += 1
        self.board.receive(encode_command(command, self.sequence, fields), self.now_ns)
        self.now_ns += ANSWERED_MS * MS
        self.board.receive(b"", self.now_ns)
        answers = [each for each in self._take() if isinstance(each, CommandAnswer)]
        return answers[-1] if answers else None

    def result(self, command: Format, *fields: int) -> CommandResult:
        answer = self.ask(command, *fields)
        assert answer is not None
        return answer.result

    def make_ready(self, options: int = 0) -> None:
        assert self.result(Format.LIMITS, *LIMITS._replace(options=options)) is DONE
        assert self.result(Format.ARM) is DONE
        assert self.result(Format.HOME, *SEARCH) is DONE
        while self.run(1).mode in (BoardMode.ARMED, BoardMode.HOMING):
            assert self.now_ns < 5_000 * MS
            # A sign of life.
            self.ask(Format.VELOCITY, 0, 20)
        assert self.state is not None
        assert self.state.mode in (BoardMode.READY, BoardMode.RUNNING)

    def press(self, force_n: float) -> None:
        """Press at 4000 steps/s until a force is reached."""
        self.make_ready()
        while self.board.force_n < force_n:
            assert self.now_ns < 5_000 * MS
            self.ask(Format.VELOCITY, VELOCITY, 20)

    def _take(self) -> list[object]:
        bodies = self._reader.feed(b"".join(self.board.due_frames()))
        reports = [decode_report(body) for body in bodies]
        for report in reports:
            if isinstance(report, BoardState):
                self.state = report
        return list(reports)


def test_a_board_is_armed_homed_and_run() -> None:
    host = Host()
    assert host.result(Format.ARM) is CommandResult.NO_LIMITS
    assert host.result(Format.HOME, *SEARCH) is CommandResult.WRONG_STATE
    assert not StateFlag.ON & host.run(2).flags
    host.make_ready()
    assert host.result(Format.LIMITS, *LIMITS) is CommandResult.WRONG_STATE
    state = host.run(20)
    assert StateFlag.HOMED in state.flags
    assert abs(state.position) < 50
    assert host.ask(Format.VELOCITY, VELOCITY, 20) is None
    assert host.run(10).velocity == pytest.approx(VELOCITY)
    # Valid for 20 ms, then at rest; withdrawn after 50 ms.
    assert host.run(25).velocity == 0
    assert StateFlag.EXPIRED in host.run(1).flags
    state = host.run(100)
    assert (state.mode, state.cause) == (BoardMode.WITHDRAWN, TripCause.SILENCE)
    assert host.ask(Format.VELOCITY, VELOCITY, 20) is None
    assert host.run(5).velocity == 0
    assert host.result(Format.CLEAR) is DONE
    assert host.run(1).mode is BoardMode.DISARMED


@pytest.mark.parametrize(
    ("field", "change"),
    [
        (1, {"lowest": -(1 << 30) - 1}), (2, {"highest": 0}), (3, {"acceleration": 999}),
        (4, {"highest_rate": 32_001}), (5, {"film_least": 16_369}), (6, {"film_most": 16_370}),
        (7, {"withdrawal": 0}), (8, {"withdrawal_rate": 9}), (9, {"watchdog_ms": 501}),
        (10, {"options": 32}),
    ],
)  # fmt: skip
def test_limits_out_of_bounds_are_refused_by_their_field(
    field: int, change: dict[str, int]
) -> None:
    answer = Host().ask(Format.LIMITS, *LIMITS._replace(**change))
    assert answer is not None
    assert (answer.result, answer.field) == (REFUSED, field)


def test_a_search_ends_where_home_cannot_be() -> None:
    host = Host()
    host.ask(Format.LIMITS, *LIMITS)
    host.ask(Format.ARM)
    assert host.result(Format.HOME, *SEARCH._replace(opening=0)) is REFUSED
    host.ask(Format.HOME, *SEARCH._replace(distance=100))
    state = host.run(100)
    assert (state.mode, state.cause) == (BoardMode.FAULT, TripCause.NO_HOME)
    assert not StateFlag.ON & state.flags


def test_only_a_homed_board_withdraws_after_a_reset() -> None:
    host = Host()
    host.ask(Format.LIMITS, *LIMITS)
    host.ask(Format.ARM)
    host.board.restart()
    assert host.run(2).mode is BoardMode.DISARMED
    host.make_ready()
    host.board.restart()
    assert host.run(2).mode is BoardMode.WITHDRAWING
    state = host.run(500)
    assert (state.mode, state.cause) == (BoardMode.WITHDRAWN, TripCause.RESET)
    assert StateFlag.HOMED not in state.flags


def test_the_film_reads_counts_with_the_noise_of_its_scene() -> None:
    host = Host(FILM, noise_n=5e-3)
    host.run(2)
    counts = [host.run(1).film for _ in range(1000)]
    assert np.mean(counts) == pytest.approx(8184, abs=1)
    assert np.std(counts) == pytest.approx(10, rel=0.1)


def test_the_film_reads_the_force_that_the_scenes_finger_gives_at_the_tip() -> None:
    host = Host(FILM, noise_n=1e-3)
    moments: list[MotorState] = []
    host.board.trace = moments.append
    host.press(0.3)
    law = actuator_of("stepdir").contact(LAYER)
    assert host.board.force_n == pytest.approx(law.force(host.board.tip_m), rel=1e-6)
    assert host.state is not None
    # The state is one millisecond older.
    assert (host.state.film - 8184) * 5e-4 == pytest.approx(moments[-2].force_n, abs=5e-3)
    assert moments[-1].speed_m_per_s == pytest.approx(4_000 * 0.625e-6, rel=0.05)
    assert list(host.board.forces_n)[-1] == moments[-1].force_n


def test_a_probe_presses_the_tissue_of_its_wrist() -> None:
    law = TissueContact(WristScene.model_validate({"kind": "wrist"}))
    host = Host(law=law)
    host.press(0.3)
    assert host.board.force_n == pytest.approx(law.force(host.board.tip_m), rel=1e-6)


@pytest.mark.parametrize(
    ("keys", "options"),
    [
        ({"inverted": True}, LimitOption.INVERTED),
        ({"home_switch": "normally_closed"}, LimitOption.NORMALLY_CLOSED),
        ({"fault_pin": "high"}, LimitOption.HAS_FAULT_PIN | LimitOption.FAULT_IS_HIGH),
    ],
)
def test_the_board_is_wired_as_its_scene_states(
    keys: dict[str, object], options: LimitOption
) -> None:
    host = Host(**{"fault_pin": "none", **keys})
    host.make_ready(options)
    host.board.fail("overtemperature")
    has_pin = LimitOption.HAS_FAULT_PIN in options
    assert (host.run(3).mode is BoardMode.WITHDRAWING) is has_pin


def test_a_motor_that_is_blocked_turns_again_when_its_fault_is_cleared() -> None:
    host = Host()
    host.make_ready()
    host.board.fail("following error")
    place_m = host.board.tip_m
    host.ask(Format.VELOCITY, VELOCITY, 20)
    assert host.run(10).position > 30
    assert host.board.tip_m == pytest.approx(place_m, abs=1e-6)
    host.board.reset()
    host.ask(Format.VELOCITY, VELOCITY, 20)
    host.run(10)
    assert host.board.tip_m - place_m == pytest.approx(12 * 4 * 0.625e-6, rel=0.1)


@pytest.mark.parametrize("trouble", ["silent", "garbled"])
def test_a_board_in_trouble_is_not_read_and_goes_on(trouble: str) -> None:
    host = Host()
    before = host.run(5)
    host.board.trouble = trouble
    assert host.run(10) == before
    host.board.trouble = ""
    assert host.run(2).counter == before.counter + 12
