"""Injected faults that nothing but the finger would show: the truth beside what is reported.

Those that are to be named fail tests/system/accuracy/test_injected_faults.py if they do nothing.
"""

import pytest

from display_node.plant.scene import StepperScene
from protocol.wire.description import LayerTable
from telepulse.emulators.motor import TICK_NS
from tests.support.fault_injection import (
    FaultInjector,
    FaultKind,
    FaultyMotor,
    InjectedFault,
)

MS = TICK_NS
TOUCH_M = 2e-3
SCENE = StepperScene.model_validate({"kind": "stepper"})
RATE_HZ = 4_000.0
RAN_MS = 100


def moved(fault: InjectedFault | None) -> FaultyMotor:
    """Run a motor for 0.1 s, with a fault from the start."""
    motor = FaultyMotor(SCENE, SCENE.contact(LayerTable().layer()), TOUCH_M, now_ns=0)
    if fault is not None:
        motor.injector.begin(fault, 0)
    motor.run(RATE_HZ)
    for ms in range(1, RAN_MS + 1):
        motor.advance(ms * MS)
    return motor


TRUE = moved(None)


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


@pytest.mark.parametrize(
    ("kind", "size", "wanted_n"),
    [
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


def test_answers_come_twice() -> None:
    injector = FaultInjector(SCENE.step_m)
    injector.begin(InjectedFault(FaultKind.DUPLICATED, 1.0), 0)
    injector.queue_answer(b"answer", 0)
    assert injector.due_answers(0) == [b"answer", b"answer"]
