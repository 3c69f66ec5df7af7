"""The emulated CiA 402 drive, in virtual time and without a bus."""

import pytest

from pulse_drives.cia402.state_machine import (
    HEARTBEAT_ERROR,
    Controlword,
    Mode,
    State,
)
from telepulse.emulators.cia402 import EmulatedCia402Drive
from tests.support.drive_benches import cia402_scene, emulated_motor, stepper

MS = 1_000_000
TO_ENABLED = (Controlword.SHUTDOWN, Controlword.SWITCH_ON, Controlword.ENABLE)


class Bench:
    """A drive in cyclic velocity mode, in operation enabled unless `enabled` is False."""

    def __init__(self, enabled: bool = True, **keys: object) -> None:
        scene = cia402_scene(**keys)
        self.motor = emulated_motor(scene, stepper(), 0)
        self.drive = EmulatedCia402Drive(scene, self.motor, (Mode.CYCLIC_VELOCITY,))
        self.now_ms = 0
        self.drive.select(Mode.CYCLIC_VELOCITY)
        if enabled:
            self.control(*TO_ENABLED)
            assert self.drive.state is State.ENABLED

    def control(self, *words: Controlword, velocity: int = 0, ms: int = 0) -> None:
        """Send controlwords, each followed by `ms`."""
        for word in words:
            self.drive.control(word, velocity)
            self.run(ms)

    def run(self, ms: int) -> None:
        for _ in range(ms):
            self.now_ms += 1
            self.drive.advance(self.now_ms * MS)


def test_it_moves_in_operation_enabled_alone_and_takes_only_modes_that_it_has() -> None:
    bench = Bench(enabled=False)
    bench.drive.select(Mode.PROFILE_VELOCITY)
    assert bench.drive.mode == Mode.CYCLIC_VELOCITY
    for word in (Controlword.ENABLE, Controlword.SHUTDOWN, Controlword.SWITCH_ON):
        bench.control(word, velocity=1000, ms=10)
        assert bench.motor.rate_hz == 0.0
    bench.control(Controlword.ENABLE, velocity=1000, ms=10)
    assert bench.motor.rate_hz == pytest.approx(1000.0)


def test_a_fault_is_reset_by_a_rising_edge_alone() -> None:
    bench = Bench()
    bench.motor.fail("overtemperature")
    bench.control(Controlword.RESET_FAULT, ms=10)
    assert bench.drive.state is State.FAULT
    bench.control(Controlword.RESET_FAULT)
    assert bench.drive.state is State.FAULT
    bench.control(Controlword.DISABLE_VOLTAGE, Controlword.RESET_FAULT)
    assert (bench.drive.state, bench.drive.error_code) == (State.SWITCH_ON_DISABLED, 0)


@pytest.mark.parametrize(
    ("option", "state", "way_back"),
    [(3, State.SWITCH_ON_DISABLED, ()), (1, State.FAULT, (Controlword.RESET_FAULT,))],
    ids=["quick stop", "fault"],
)
def test_after_a_missed_heartbeat_it_rests_until_it_is_enabled_again(
    option: int, state: State, way_back: tuple[Controlword, ...]
) -> None:
    bench = Bench()
    drive, motor = bench.drive, bench.motor
    drive.abort_option = option
    motor.set_watchdog(50 * MS)
    bench.control(Controlword.ENABLE, velocity=20_000, ms=100)
    assert (drive.state, drive.error_code, motor.rate_hz) == (state, HEARTBEAT_ERROR, 0.0)
    if way_back:
        for word in (Controlword.ENABLE, *TO_ENABLED):
            bench.control(word, velocity=-1_000, ms=10)
            assert (drive.state, motor.rate_hz) == (State.FAULT, 0.0)
    bench.control(*way_back, *TO_ENABLED, velocity=-1_000, ms=10)
    # The missed heartbeat was one event: none came since, and the drive obeys.
    bench.run(100)
    assert (drive.state, motor.rate_hz) == (State.ENABLED, pytest.approx(-1_000))
