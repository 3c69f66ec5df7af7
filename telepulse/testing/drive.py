"""Conformance of real drives, on an emulation or on a motor that presses nobody."""

import math
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

from display_node.plant.scene import StepperScene
from protocol.config.scene import validate
from pulse_drives import Drive, build_drive
from pulse_drives.drive import PERIOD_S
from pulse_drives.scene import DriveScene
from telepulse.testing.conformance import call_within, check_release, read_table, require

# Furthest travel from first touch in the checks.
DEEPEST_M = 1e-3
SPEED_M_PER_S = 5e-3
FORWARD_S = 0.15
# Faster than the tip may go near the soft limit, which slows it.
LIMIT_M_PER_S = 20e-3
CLOSED_WITHIN_S = 5.0
# The longest withdrawal: the depth at the slow speed, with the time to notice a fault.
WITHDRAWN_WITHIN_S = 2.0
# A command that waits for the drive takes as long as an exchange on its line.
COMMAND_S = 1e-3


def check_drive(
    section: type[DriveScene],
    keys: Mapping[str, Any],
    position_m: Callable[[], float],
    actuator: Mapping[str, Any] | None = None,
) -> None:
    """Check a kind of drive: it starts, presses by up to 1 mm, and is withdrawn, some seconds long.

    Parameters
    ----------
    position_m
        Function that returns the true position of the tip in m, 0 at first touch: of the
        emulation, or of a gauge beside the drive.
    actuator
        Keys of the motor, as in [display.actuator]; by default those of a stepper.

    Notes
    -----
    No command may wait, no motion go the wrong way or beyond the soft limits. The tip must leave
    the finger without commands, after a withdrawal and after an exception of the device, and the
    drive start again and be released.
    """
    table = read_table(section, keys)
    require(hasattr(section, "driver"), f'{section.__name__} lacks driver = "module:class"')
    motor = validate({"kind": "stepper", **(actuator or {})}, StepperScene, "actuator:")
    with check_release("close"):
        drive = call_within(10.0, "the drive's class", lambda: build_drive(table, motor, DEEPEST_M))
        require(isinstance(drive, Drive), f"{table.driver} is no Drive")
        try:
            _start(drive, position_m)
            _check_commands(drive, position_m)
            _check_limit(drive, position_m)
            # Without commands for the watchdog's time, the drive withdraws the tip.
            time.sleep(table.watchdog_ns * 1e-9)
            _check_withdrawn(drive, position_m, "without commands")
            _start(drive, position_m)
            _keep(drive, SPEED_M_PER_S, FORWARD_S)
            drive.withdraw()
            _check_withdrawn(drive, position_m, "after withdraw()", SPEED_M_PER_S)
            _check_error(drive, position_m)
        finally:
            call_within(CLOSED_WITHIN_S, "close", drive.close)
        rested_m = position_m()
        time.sleep(0.1)
        require(position_m() == rested_m, "the tip moves after close")
        call_within(CLOSED_WITHIN_S, "a second close", drive.close)


def _start(drive: Drive, position_m: Callable[[], float]) -> None:
    call_within(60.0, "start", drive.start)
    status = drive.status()
    require(status.fault is None, f"after start there is a fault: {status.fault}")
    require(
        abs(position_m()) < 0.1e-3,
        f"after start the tip is {position_m() * 1e3:.3f} mm from first touch, not at it",
    )


def _keep(drive: Drive, speed_m_per_s: float, seconds: float) -> list[float]:
    """Repeat a command; return the times in s that the calls took."""
    taken_s, end_s = [], time.monotonic() + seconds
    while (began_s := time.monotonic()) < end_s:
        drive.command(speed_m_per_s)
        taken_s.append(time.monotonic() - began_s)
        time.sleep(PERIOD_S)
    return taken_s


def _check_commands(drive: Drive, position_m: Callable[[], float]) -> None:
    began_m = position_m()
    taken_s = statistics.median(_keep(drive, SPEED_M_PER_S, FORWARD_S))
    require(
        taken_s < COMMAND_S,
        f"command takes {taken_s * 1e3:.1f} ms: it must not wait for the drive",
    )
    moved_m = position_m() - began_m
    share = moved_m / (SPEED_M_PER_S * FORWARD_S)
    require(
        share > 0.3,
        f"a speed into the finger for {FORWARD_S:g} s moved the tip by {moved_m * 1e3:.3f} mm",
    )
    require(share < 2.0, f"the tip moves {share:.1f} times as fast as commanded")
    fault = drive.status().fault
    require(fault is None, f"commands at {SPEED_M_PER_S * 1e3:g} mm/s cause a fault: {fault}")
    _keep(drive, math.nan, 0.05)
    rest_m = position_m()
    _keep(drive, math.nan, 0.05)
    moved_m = position_m() - rest_m
    require(
        abs(moved_m) < 0.02e-3,
        f"a speed that is not a number moves the tip by {moved_m * 1e3:.3f} mm",
    )


def _check_limit(drive: Drive, position_m: Callable[[], float]) -> None:
    furthest_m, end_s = -math.inf, time.monotonic() + 1.0
    while time.monotonic() < end_s:
        drive.command(LIMIT_M_PER_S)
        furthest_m = max(furthest_m, position_m())
        require(
            furthest_m <= DEEPEST_M,
            f"the tip went to {furthest_m * 1e3:.3f} mm, and the soft limit is"
            f" {DEEPEST_M * 1e3:g} mm: commands must pass through the Supervisor",
        )
        time.sleep(PERIOD_S)
    fault = drive.status().fault
    require(fault is None, f"at the soft limit there is a fault: {fault}")


def _check_error(drive: Drive, position_m: Callable[[], float]) -> None:
    """Check that what sending a speed raises is a fault, after which the tip is withdrawn."""
    _start(drive, position_m)
    _keep(drive, SPEED_M_PER_S, FORWARD_S)
    send = drive._send
    raised: list[int] = []

    def fail_once(now_ns: int) -> None:
        if not raised:
            raised.append(now_ns)
            raise RuntimeError("conformance test")
        send(now_ns)

    drive._send = fail_once  # type: ignore[method-assign]
    try:
        drive.command(SPEED_M_PER_S)
        _check_withdrawn(drive, position_m, "after an exception of its device", SPEED_M_PER_S)
    finally:
        drive._send = send  # type: ignore[method-assign]
    cause = "" if (fault := drive.status().fault) is None else fault.cause
    require(
        RuntimeError.__name__ in cause,
        f"after an exception of its device the fault is {cause!r}: let it reach the Drive",
    )


def _check_withdrawn(
    drive: Drive, position_m: Callable[[], float], when: str, command: float | None = None
) -> None:
    end_s = time.monotonic() + WITHDRAWN_WITHIN_S
    while position_m() >= 0 or drive.status().moving:
        require(
            time.monotonic() < end_s,
            f"{when} the tip is {position_m() * 1e3:.3f} mm into the finger after"
            f" {WITHDRAWN_WITHIN_S:g} s: the drive's own thread must withdraw it",
        )
        if command is not None:
            drive.command(command)
        time.sleep(PERIOD_S)
    require(drive.status().fault is not None, f"{when} there is no fault")
