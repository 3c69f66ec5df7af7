"""The withdrawal of the tip, with any reports of position and film, and the sentence about it."""

import pytest

from protocol.finger import FingerState, WithdrawalOutcome, describe_finger
from pulse_drives.withdrawal import (
    FAST_M_PER_S,
    FILM_SILENT_NS,
    MARGIN_M,
    OVERDUE_NS,
    PATIENCE_NS,
    SLOW_M_PER_S,
    Withdrawal,
)

UNDER_WAY, WITHDRAWN, RELIEVED, UNCONFIRMED, WRONG_WAY = WithdrawalOutcome


@pytest.mark.parametrize(
    ("state", "sentence"),
    [
        (FingerState(), ""),
        (FingerState(0.245), "pressed with 245 mN"),
        (FingerState(0.003), "not pressed"),
        (FingerState(0.245, 0.0, "model"), "pressed with 245 mN (model)"),
        (FingerState(None, 3.2), "force unknown since 3 s"),
        (FingerState(0.245, 0.0, "", UNDER_WAY), "pressed with 245 mN, withdrawing"),
        (FingerState(0.0, 0.0, "", WITHDRAWN), "withdrawn"),
        (FingerState(0.0, 0.0, "", RELIEVED), "not pressed, the drive's position is unknown"),
        (FingerState(0.0, 0.0, "by the drive's position", WITHDRAWN), "withdrawn"),
        (
            FingerState(None, 3.0, "", WITHDRAWN),
            "withdrawn by the drive's position, force unknown since 3 s",
        ),
        (
            FingerState(0.245, 0.0, "", WITHDRAWN),
            "pressed with 245 mN, although the drive reports the tip withdrawn",
        ),
        (
            FingerState(0.245, 0.0, "", UNCONFIRMED),
            "pressed with 245 mN, the drive does not confirm its withdrawal",
        ),
        (
            FingerState(0.5, 0.0, "", WRONG_WAY),
            "pressed with 500 mN, withdrawal stopped as it went towards the finger",
        ),
        (FingerState(0.245, answers=False), "pressed with 245 mN, the drive does not answer"),
        (
            FingerState(None, 3.0, "", WITHDRAWN, answers=False),
            "force unknown since 3 s, the drive does not answer",
        ),
    ],
)
def test_the_sentence_states_only_measured_facts(state: FingerState, sentence: str) -> None:
    assert describe_finger(state) == sentence


MS = 1_000_000
CLEAR_M = -0.5e-3
BEGAN_M = 0.6e-3


class Tip:
    """A tip that obeys the withdrawal, with `gain` m of motion for each m commanded."""

    def __init__(
        self,
        trusted: bool = True,
        gain: float = 1.0,
        film_trusted: bool = True,
        began_m: float = BEGAN_M,
    ) -> None:
        self.withdrawal = Withdrawal(0, began_m, 0.0, CLEAR_M, trusted, film_trusted)
        self.gain = gain
        self.position_m = began_m
        self.travel_m = 0.0
        self.now_ms = 0
        self.reports = True

    def run(self, ms: int, force: bool = False) -> WithdrawalOutcome:
        for _ in range(ms):
            self.now_ms += 1
            speed = self.withdrawal.speed_m_per_s(self.now_ms * MS, self.travel_m)
            assert -FAST_M_PER_S <= speed <= 0
            self.travel_m += speed * 1e-3
            self.position_m += self.gain * speed * 1e-3
            if self.reports:
                self.withdrawal.add_position(self.position_m, self.now_ms * MS)
            if force:
                self.withdrawal.add_force_reading(max(0.0, self.position_m * 1e3), self.now_ms * MS)
        return self.withdrawal.outcome


def test_a_withdrawal_is_slow_until_confirmed_and_ends_off_the_finger() -> None:
    tip = Tip()
    assert tip.withdrawal.speed_m_per_s(MS, 0.0) == -SLOW_M_PER_S
    assert tip.run(100) is WithdrawalOutcome.WITHDRAWN
    assert tip.withdrawal.confirmed
    assert tip.position_m == pytest.approx(CLEAR_M, abs=FAST_M_PER_S * 1e-3)
    assert tip.withdrawal.speed_m_per_s(101 * MS, tip.travel_m) == 0


@pytest.mark.parametrize("by_film", [False, True], ids=["position", "film"])
def test_a_motion_towards_the_finger_is_stopped_at_once(by_film: bool) -> None:
    tip = Tip(gain=-1.0)
    tip.reports = not by_film
    assert tip.run(200, force=by_film) is WithdrawalOutcome.WRONG_WAY
    # The position's bound is 0.1 mm; both may show a motion towards the finger for some time.
    assert tip.position_m < BEGAN_M + (0.7e-3 if by_film else 0.5e-3)
    assert tip.withdrawal.speed_m_per_s(300 * MS, tip.travel_m) == 0


def test_a_single_position_or_reading_stops_nothing() -> None:
    tip = Tip()
    tip.run(40)
    tip.withdrawal.add_position(9e-3, 41 * MS)
    assert tip.run(100) is WithdrawalOutcome.WITHDRAWN
    tip = Tip()
    tip.run(20)
    tip.withdrawal.add_force_reading(0.3, 20 * MS)
    for ms in (90, 91):
        tip.withdrawal.add_force_reading(9.0, ms * MS)
    tip.withdrawal.add_force_reading(0.0, 92 * MS)
    assert tip.withdrawal.outcome is WithdrawalOutcome.UNDER_WAY


@pytest.mark.parametrize("trusted", [True, False])
def test_without_a_confirmation_the_commanded_travel_ends_it(trusted: bool) -> None:
    tip = Tip(trusted)
    tip.reports = False
    assert tip.run(1_000) is WithdrawalOutcome.UNCONFIRMED
    needed_m = BEGAN_M - CLEAR_M + MARGIN_M
    assert -tip.travel_m == pytest.approx(needed_m, rel=0.01)
    assert tip.position_m < CLEAR_M


def test_a_relieved_film_confirms_the_commanded_travel() -> None:
    tip = Tip()
    tip.reports = False
    # The position is unknown, so nobody claims that it is withdrawn.
    assert tip.run(1_000, force=True) is WithdrawalOutcome.RELIEVED
    assert tip.position_m < CLEAR_M
    # The travel while a position is still expected.
    assert -tip.travel_m < 1.01 * FAST_M_PER_S * PATIENCE_NS * 1e-9


def test_commands_that_a_silent_drive_has_missed_are_repeated() -> None:
    tip = Tip(gain=0.0)
    tip.reports = False
    assert tip.run(1_000) is WithdrawalOutcome.UNCONFIRMED
    tip.gain, tip.reports = 1.0, True
    assert tip.run(200) is WithdrawalOutcome.WITHDRAWN


def test_a_held_motor_is_commanded_until_it_moves() -> None:
    tip = Tip(gain=0.0)
    for _ in range(500):
        tip.run(10)
        tip.withdrawal.restart(tip.now_ms * MS, tip.travel_m)
    # It takes too long to be called under way, and goes on all the same.
    assert tip.withdrawal.outcome is WithdrawalOutcome.UNCONFIRMED
    tip.gain = 1.0
    assert tip.run(200) is WithdrawalOutcome.WITHDRAWN


def test_a_pressed_film_continues_an_unconfirmed_withdrawal() -> None:
    tip = Tip(trusted=False, gain=0.0)
    assert tip.run(1_000, force=True) is WithdrawalOutcome.UNCONFIRMED
    tip.gain = 1.0
    tip.run(1_000, force=True)
    assert tip.position_m < 0.06e-3


def test_after_a_stall_of_the_host_the_tip_may_reverse_again() -> None:
    """The drive moved towards the finger until its own watchdog stopped it."""
    tip = Tip()
    tip.run(3)
    tip.now_ms += 1_000
    tip.position_m += 2e-3
    assert tip.run(300) is WithdrawalOutcome.WITHDRAWN


def test_a_command_before_a_stall_does_not_count_as_travel() -> None:
    """The drive's watchdog ended the command, which counted for 0.4 s."""
    tip = Tip()
    assert tip.withdrawal.speed_m_per_s(MS, 0.0) == -SLOW_M_PER_S
    tip.now_ms, tip.travel_m = 400, -SLOW_M_PER_S * 0.4
    for ms in range(2, 400):
        tip.withdrawal.add_position(BEGAN_M, ms * MS)
    assert tip.run(100) is WithdrawalOutcome.WITHDRAWN
    assert tip.position_m == pytest.approx(CLEAR_M, abs=FAST_M_PER_S * 1e-3)


def test_readings_that_rise_before_the_first_command_stop_nothing() -> None:
    """The loop reads the film while the drive's thread stalls."""
    tip = Tip()
    for ms in range(1, 200, 4):
        tip.withdrawal.add_force_reading(0.3 + 1e-3 * ms, ms * MS)
        tip.withdrawal.add_position(BEGAN_M + 1e-6 * ms, ms * MS)
    assert tip.withdrawal.outcome is WithdrawalOutcome.UNDER_WAY
    tip.now_ms = 200
    tip.position_m += 0.2e-3
    assert tip.run(300) is WithdrawalOutcome.WITHDRAWN


@pytest.mark.parametrize("first_ms", [None, 2], ids=["none before", "one before"])
def test_a_film_that_is_read_again_late_does_not_stop_a_tip_that_leaves(
    first_ms: int | None,
) -> None:
    """The loop reads it: while that hangs, the drive's thread withdraws without it."""
    tip = Tip(began_m=2e-3)
    if first_ms is not None:
        tip.run(first_ms)
        # Until the drive had taken the first command, the tip pressed on.
        tip.withdrawal.add_force_reading(0.1, first_ms * MS)
    tip.run(60)
    assert tip.run(5, force=True) is WithdrawalOutcome.UNDER_WAY
    assert tip.position_m > 0.5e-3
    assert tip.run(100, force=True) is WithdrawalOutcome.WITHDRAWN


def test_a_tip_that_pressed_on_while_commands_were_lost_is_not_stopped_when_it_leaves() -> None:
    tip = Tip()
    tip.gain, tip.reports = -3.0, False
    tip.run(40)
    tip.gain, tip.reports = 1.0, True
    # Now 1.2 mm further, which the first reports show.
    assert tip.position_m > BEGAN_M + 1e-3
    assert tip.run(300) is WithdrawalOutcome.WITHDRAWN


def test_a_motor_that_is_held_for_longer_than_the_travel_takes_is_commanded_on() -> None:
    tip = Tip(gain=0.0)
    assert tip.run(1_000) is WithdrawalOutcome.UNCONFIRMED
    tip.gain = 1.0
    assert tip.run(200) is WithdrawalOutcome.WITHDRAWN


def test_a_film_that_is_at_fault_stops_nothing_that_the_position_confirms() -> None:
    """Stuck at 1.2 N, it reads 1.9 N while the tip leaves."""
    tip = Tip(film_trusted=False)
    for ms in range(1, 200):
        tip.withdrawal.add_force_reading(1.2 if ms < 60 else 1.9, ms * MS)
        tip.run(1)
    assert tip.withdrawal.outcome is WithdrawalOutcome.WITHDRAWN
    stopped = Tip()
    for ms in range(1, 200):
        stopped.withdrawal.add_force_reading(1.2 if ms < 60 else 1.9 + 1e-3 * ms, ms * MS)
        stopped.run(1)
    assert stopped.withdrawal.outcome is WithdrawalOutcome.WRONG_WAY
    assert stopped.withdrawal.stopped_by_film


def test_withdrawn_is_not_claimed_while_a_film_that_can_be_trusted_reads_a_press() -> None:
    tip = Tip()
    for ms in range(1, 1_000):
        tip.withdrawal.add_force_reading(0.3, ms * MS)
        tip.run(1)
        assert tip.withdrawal.outcome is not WithdrawalOutcome.WITHDRAWN
    assert tip.position_m < CLEAR_M
    assert tip.withdrawal.outcome is WithdrawalOutcome.UNCONFIRMED
    # A reading of some time ago shows nothing; the position then stands alone.
    assert tip.run(FILM_SILENT_NS // MS + 50) is WithdrawalOutcome.WITHDRAWN


def test_withdrawn_is_not_claimed_by_a_position_that_cannot_be_trusted() -> None:
    tip = Tip(trusted=False)
    assert tip.run(1_000) is WithdrawalOutcome.UNCONFIRMED
    assert tip.position_m < CLEAR_M


def test_one_that_is_handed_over_sends_nothing_and_ends_by_the_boards_positions() -> None:
    tip = Tip(gain=-1.0)
    assert tip.run(200) is WithdrawalOutcome.WRONG_WAY
    tip.withdrawal.hand_over(tip.now_ms * MS)
    assert tip.withdrawal.speed_m_per_s(tip.now_ms * MS, tip.travel_m) == 0
    for place_m in (0.3e-3, 0.0, -0.3e-3, -0.6e-3):
        tip.now_ms += 50
        tip.withdrawal.add_position(place_m, tip.now_ms * MS)
    assert tip.withdrawal.outcome is WithdrawalOutcome.WITHDRAWN
    # One that takes too long is unconfirmed.
    tip = Tip(gain=-1.0)
    tip.run(200)
    tip.withdrawal.hand_over(tip.now_ms * MS)
    assert tip.run(OVERDUE_NS // MS + 20) is WithdrawalOutcome.UNCONFIRMED
