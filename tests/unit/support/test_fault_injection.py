"""Injected faults of the emulated drives, in virtual time: the truth beside what is reported."""

import pytest

from display_node.plant.scene import StepperScene
from protocol.wire.stream import LayerTable
from pulse_drives.scene import TmclScene
from telepulse.emulators.motor import TICK_NS
from telepulse.emulators.tmcl import EmulatedTmclModule
from tests.support.fault_injection import (
    FaultInjector,
    FaultKind,
    FaultyMotor,
    InjectedFault,
    parse_fault,
)

MS = TICK_NS
TOUCH_M = 2e-3
SCENE = StepperScene.model_validate({"kind": "stepper"})
RATE_HZ = 4_000.0
RAN_MS = 100


def moved(fault: InjectedFault | None, rate_hz: float = RATE_HZ) -> FaultyMotor:
    """Run a motor for 0.1 s, with a fault from the start."""
    motor = FaultyMotor(SCENE, SCENE.contact(LayerTable().layer()), TOUCH_M, now_ns=0)
    if fault is not None:
        motor.injector.begin(fault, 0)
        # A position freezes at its first report.
        _ = motor.position_steps
    motor.run(rate_hz)
    for ms in range(1, RAN_MS + 1):
        motor.advance(ms * MS)
    return motor


TRUE = moved(None)
TRAVEL_M = TRUE.tip_m + TOUCH_M / 2


@pytest.mark.parametrize(
    ("kind", "size", "turned", "reported"),
    [
        (FaultKind.REVERSED, 0.0, -1, 1),
        (FaultKind.REVERSED_ENCODER, 0.0, -1, -1),
        (FaultKind.GAIN, 2.0, 2, 1),
        (FaultKind.GAIN, 0.3, 0.3, 1),
        (FaultKind.GAIN_ENCODER, 2.0, 2, 2),
        (FaultKind.POSITION_FROZEN, 0.0, 1, 0),
    ],
)
def test_a_fault_changes_the_shafts_turns_or_the_reported_position(
    kind: FaultKind, size: float, turned: float, reported: float
) -> None:
    motor = moved(InjectedFault(kind, size))
    assert motor.tip_m + TOUCH_M / 2 == pytest.approx(turned * TRAVEL_M, abs=3e-6)
    assert motor.position_steps == pytest.approx(reported * TRUE.position_steps, abs=2)


@pytest.mark.parametrize(
    ("kind", "size", "off_m"),
    [
        (FaultKind.POSITION_JUMP, 0.5e-3, 0.5e-3),
        (FaultKind.POSITION_DRIFT, -2e-3, -2e-3 * RAN_MS * 1e-3),
    ],
)
def test_a_reported_position_that_is_off(kind: FaultKind, size: float, off_m: float) -> None:
    motor = moved(InjectedFault(kind, size))
    assert motor.tip_m == TRUE.tip_m
    off_steps = motor.position_steps - TRUE.position_steps
    assert off_steps * SCENE.step_m == pytest.approx(off_m, abs=SCENE.step_m)


def test_a_retraction_that_is_ignored() -> None:
    motor = moved(InjectedFault(FaultKind.NO_RETRACTION), -RATE_HZ)
    assert motor.rate_hz == 0.0
    motor.run(RATE_HZ)
    motor.advance((RAN_MS + 10) * MS)
    assert motor.rate_hz == pytest.approx(RATE_HZ)


def test_a_reversed_motor_runs_away_from_its_home_switch() -> None:
    motor = moved(InjectedFault(FaultKind.REVERSED), 0.0)
    motor.home(RATE_HZ, RATE_HZ / 4)
    motor.advance(1_000 * MS)
    assert motor.homing
    assert motor.force_n > 1.0


@pytest.mark.parametrize(
    ("kind", "size", "wanted_n"),
    [
        (FaultKind.FILM_ZERO, 0.0, (0.0, 0.0)),
        (FaultKind.FILM_FROZEN, 0.0, (0.4, 0.4)),
        (FaultKind.FILM_SCALED, 0.5, (0.2, 0.4)),
    ],
)
def test_a_fault_changes_the_films_force(
    kind: FaultKind, size: float, wanted_n: tuple[float, float]
) -> None:
    injector = FaultInjector(SCENE.step_m)
    injector.begin(InjectedFault(kind, size), 0)
    assert (injector.film_n(0.4), injector.film_n(0.8)) == wanted_n


@pytest.mark.parametrize(
    ("kind", "size", "sent"),
    [
        (FaultKind.DELAYED, 0.03, {30: 1}),
        (FaultKind.LOST, 1.0, {}),
        (FaultKind.DUPLICATED, 1.0, {0: 2}),
        (FaultKind.GARBAGE, 1.0, {0: 1}),
        (FaultKind.POSITION_FROZEN, 0.0, {0: 1}),
    ],
)
def test_answers_are_late_missing_doubled_or_spoilt(
    kind: FaultKind, size: float, sent: dict[int, int]
) -> None:
    injector, answer = FaultInjector(SCENE.step_m), bytes(range(9))
    injector.begin(InjectedFault(kind, size), 0)
    injector.queue_answer(answer, 0, header=2)
    found = {ms: injector.due_answers(ms * MS) for ms in range(40)}
    assert {ms: len(answers) for ms, answers in found.items() if answers} == sent
    for data in (data for answers in found.values() for data in answers):
        assert data[:2] == answer[:2]
        assert (data != answer) == (kind is FaultKind.GARBAGE)


def test_a_fault_begins_when_it_is_begun() -> None:
    motor = moved(None)
    at = motor.position_steps
    motor.injector.begin(InjectedFault(FaultKind.POSITION_FROZEN), RAN_MS * MS)
    scene = TmclScene.model_validate({"kind": "tmcl", "port": "x"})
    module = EmulatedTmclModule(scene, motor)
    asked = bytes.fromhex("01 06 01 00 00 00 00 00 08")
    replies = {module.reply(asked, (RAN_MS + ms) * MS) for ms in (0, 50, 100)}
    assert [int.from_bytes(reply[4:8], "big") for reply in replies] == [at]


def test_a_size_is_in_its_unit() -> None:
    assert parse_fault(FaultKind.DELAYED, "45 ms") == InjectedFault(FaultKind.DELAYED, 0.045)
    assert parse_fault(FaultKind.LOST, "20 %") == InjectedFault(FaultKind.LOST, 0.2)
    assert parse_fault(FaultKind.FILM_NOISE, None) == InjectedFault(FaultKind.FILM_NOISE, 0.2)
    assert parse_fault(FaultKind.FILM_ZERO, None) == InjectedFault(FaultKind.FILM_ZERO)
