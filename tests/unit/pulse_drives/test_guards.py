"""Exceptions that no code expects, in each method of each device, at each moment, in virtual time.

None ends the drive's thread: it is a fault with its place, and the tip leaves the finger wherever
the device obeys.
"""

import termios
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any
from unittest.mock import patch

import pytest
from telepulse_example.stage import STAGES, Stage, StageScene

from protocol.errors import DriveError
from protocol.faults import FaultKind
from pulse_drives import Drive, build_drive
from pulse_drives.cia402.node import Cia402Node
from pulse_drives.stepdir.board import DisplayBoard
from pulse_drives.stepdir.line import BoardLine
from pulse_drives.supervisor import GIVEN_UP
from pulse_drives.tmcl.line import TmclLine
from pulse_drives.tmcl.module import TmclModule
from pulse_drives.withdrawal import WithdrawalOutcome
from tests.support.drive_benches import Bench, stepper, virtual_bench
from tests.support.virtual_time import VirtualTime

RATE_HZ = 400.0
MS = 1_000_000
DEPTH_M = 0.1e-3
# Until a fault is latched, and until it is known what has become of the tip.
NAMED_WITHIN_MS = 500
OVER_WITHIN_MS = 3_500
# Made anew each time: an exception that is raised again keeps the traceback of all times.
ERRORS = {
    "RuntimeError": lambda: RuntimeError("no"),
    "termios.error": lambda: termios.error(5, "Input/output error"),
    "MemoryError": MemoryError,
}
Error = Callable[[], BaseException]
METHODS = {
    "tmcl": (
        *((TmclModule, name) for name in ("configure", "home", "arm_watchdog", "rotate", "read")),
        *((TmclModule, name) for name in ("end_search", "close")),
        *((TmclLine, name) for name in ("request", "close")),
    ),
    "cia402": tuple(
        (Cia402Node, name)
        for name in (
            *("configure", "home", "arm_watchdog", "end_search", "command", "send_heartbeat"),
            *("start_again", "read", "write", "close", "fault"),
            *("_on_state", "_on_speed", "_on_heartbeat"),
        )
    ),
    "stepdir": (
        *((DisplayBoard, name) for name in ("configure", "home", "arm_watchdog", "end_search")),
        *((DisplayBoard, name) for name in ("send_velocity", "refresh", "fault", "close")),
        *((BoardLine, name) for name in ("send", "request", "_read", "_take", "detach")),
    ),
}
CASES = [(kind, owner, name) for kind, methods in METHODS.items() for owner, name in methods]
# Without these no command, or no velocity, reaches the device: its own watchdog must act.
SENDING = {"rotate", "request", "command", "send_velocity", "send", "write"}


class Sabotage:
    """A method that raises from its n-th call on, counted while it is armed.

    lasting: at each further call as well. hit: whether it has raised.
    """

    def __init__(self, error: Error, number: int, lasting: bool) -> None:
        self._error, self._left, self._lasting = error, number, lasting
        self.armed = self.hit = self._over = False

    def arm(self) -> None:
        self.armed = not self._over

    def over(self) -> None:
        self.armed, self._over = False, True

    def apply(self, method: Callable[..., Any], *args: Any, **options: Any) -> Any:
        if self.armed:
            self._left -= 1
            if self._left == 0 or (self._lasting and self._left < 0):
                self.hit = True
                raise self._error()
        return method(*args, **options)


def arm_while_homing(bench: Bench, sabotage: Sabotage) -> None:
    if bench.motor.homing:
        sabotage.arm()


@contextmanager
def sabotaged(
    owner: type, name: str, error: Error, number: int, lasting: bool
) -> Iterator[Sabotage]:
    sabotage, method = Sabotage(error, number, lasting), getattr(owner, name)

    def replacement(*args: Any, **options: Any) -> Any:
        return sabotage.apply(method, *args, **options)

    with patch.object(owner, name, replacement):
        yield sabotage


def run(bench: Bench, ms: int, until: Callable[[], object] = bool) -> int:
    """Let time pass until something holds, commanding as the loop does; return the ms."""
    for passed in range(ms):
        if until():
            return passed
        if not bench.fault:
            bench.drive.command(RATE_HZ * bench.actuator.step_m)
        bench.clock.sleep(0.001)
    return ms


def check_rest(bench: Bench, sabotage: Sabotage, obeys: bool) -> None:
    """Check what has become of a tip after a fault."""
    drive = bench.drive
    run(bench, OVER_WITHIN_MS, lambda: drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
    run(bench, 500, lambda: bench.at_rest)
    outcome = drive.status().withdrawal
    assert bench.at_rest
    if obeys:
        assert bench.motor.force_n == 0.0
        assert outcome is not WithdrawalOutcome.WRONG_WAY
    elif bench.motor.force_n > 0:
        # Nobody may claim that the tip is off the finger, or wait for that without end.
        assert outcome in GIVEN_UP


def start_error(bench: Bench) -> DriveError | None:
    return start_error_of(bench.drive)


def start_error_of(drive: Drive) -> DriveError | None:
    """Start a drive; return its error, None where it starts."""
    try:
        drive.start()
    except DriveError as error:
        return error
    return None


@contextmanager
def sabotaged_bench(
    kind: str, owner: type, name: str, error: Error, number: int, lasting: bool
) -> Iterator[tuple[Bench, Sabotage]]:
    with ExitStack() as stack:
        sabotage = stack.enter_context(sabotaged(owner, name, error, number, lasting))
        bench = stack.enter_context(virtual_bench(kind, touch="0.6 mm"))
        yield bench, sabotage
        sabotage.armed = False


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("moment", ["start", "homing"])
@pytest.mark.parametrize(("kind", "owner", "name"), CASES)
def test_a_start_that_fails_in_any_way_leaves_the_tip_off_and_the_drive_closed(
    kind: str, owner: type, name: str, moment: str, error: str
) -> None:
    for number in (1, 3):
        with sabotaged_bench(kind, owner, name, ERRORS[error], number, True) as (bench, sabotage):
            sabotage.armed = moment == "start"
            if moment == "homing":
                bench.clock.every(MS, partial(arm_while_homing, bench, sabotage))
            raised = start_error(bench)
            if raised is None:
                # The method is not called at this moment, or not so often.
                bench.drive.withdraw()
            else:
                assert sabotage.hit
                assert bench.fault
                assert raised.kind is not FaultKind.INTERNAL or error in str(raised)
            run(bench, 2_000, lambda: bench.at_rest)
            assert bench.motor.force_n < 5e-3
            sabotage.over()
            bench.drive.close()
            # What was wrong is over: it starts again, and presses.
            bench.wait(lambda: bench.at_rest)
            bench.motor.reset()
            bench.start(RATE_HZ, DEPTH_M)


@pytest.mark.parametrize("lasting", [False, True], ids=["once", "lasting"])
@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("moment", ["running", "withdrawal"])
@pytest.mark.parametrize(("kind", "owner", "name"), CASES)
def test_whatever_a_device_raises_is_a_fault_and_the_tip_leaves(
    kind: str, owner: type, name: str, moment: str, error: str, lasting: bool
) -> None:
    for number in (1, 5):
        with sabotaged_bench(kind, owner, name, ERRORS[error], number, lasting) as (
            bench,
            sabotage,
        ):
            bench.start(RATE_HZ, DEPTH_M)
            if moment == "withdrawal":
                bench.drive.withdraw()
            sabotage.armed = True
            hit_ms = run(bench, 300, lambda: sabotage.hit)
            if not sabotage.hit:
                # The method is not called at this moment.
                continue
            run(bench, NAMED_WITHIN_MS, partial(getattr, bench, "fault"))
            fault = bench.drive.status().fault
            assert fault is not None, hit_ms
            if moment == "running" and fault.kind is FaultKind.INTERNAL:
                assert error in fault.cause
            check_rest(bench, sabotage, obeys=not lasting or name not in SENDING)
            sabotage.armed = False
            bench.drive.close()


def test_every_method_is_reached_at_some_moment() -> None:
    """A method that no moment reaches would make its tests empty."""
    for kind, owner, name in CASES:
        hit = False
        for moment in ("start", "running"):
            with sabotaged_bench(kind, owner, name, ERRORS["RuntimeError"], 1, False) as (
                bench,
                it,
            ):
                it.armed = moment == "start"
                try:
                    bench.start(RATE_HZ, DEPTH_M)
                    it.armed = True
                    bench.drive.withdraw()
                    run(bench, 100)
                    bench.drive.close()
                except DriveError:
                    assert it.hit
                hit = hit or it.hit
        assert hit or name in ("end_search", "start_again"), (kind, name)


@pytest.mark.parametrize("error", ERRORS)
@pytest.mark.parametrize("name", ["configure", "home", "arm_watchdog", "run", "close"])
def test_the_drive_of_the_example_plug_in_is_guarded_as_well(name: str, error: str) -> None:
    world = VirtualTime()
    # It is emulated by a clock, and so in virtual time.
    with world.substituted(("protocol.host.guard", "pulse_drives", "telepulse_example")):
        scene = StageScene.model_validate({"kind": "stage", "name": f"{name} {error}"})
        drive = build_drive(scene, stepper(), DEPTH_M * 20)
        stage = STAGES[scene.name]

        def press(ms: int) -> None:
            for _ in range(ms):
                drive.command(5e-3)
                world.sleep(0.001)

        for moment in ("start", "running", "withdrawal"):
            with sabotaged(Stage, name, ERRORS[error], 1, False) as sabotage:
                sabotage.armed = moment == "start"
                if start_error_of(drive):
                    assert sabotage.hit
                    assert drive.status().fault is not None
                    assert stage.position_m <= 0
                    continue
                press(100)
                assert stage.position_m > 0 or sabotage.hit
                if moment == "withdrawal":
                    drive.withdraw()
                sabotage.armed = True
                press(500)
                assert not sabotage.hit or drive.status().fault is not None
            press(100)
            drive.close()
            assert stage.position_m <= 0 or not sabotage.hit or name == "close"
