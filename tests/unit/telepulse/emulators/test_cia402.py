"""The emulated CiA 402 drive, in virtual time and without a bus."""

import pytest

from display_node.drives.cia402.state_machine import (
    HERE,
    HOMING_ATTAINED,
    HOMING_ERROR,
    NEGATIVE_SWITCH,
    POSITIVE_SWITCH,
    Control,
    Mode,
    State,
)
from display_node.drives.scene import Cia402Scene
from display_node.plant.stepper import StepperScene
from protocol.wire.stream import LayerTable
from telepulse.emulators.cia402 import (
    HEARTBEAT_ERROR,
    NEGATIVE_LIMIT,
    POSITIVE_LIMIT,
    EmulatedCia402Drive,
)
from telepulse.emulators.motor import EmulatedMotor

MS = 1_000_000
ACTUATOR = StepperScene.model_validate({"kind": "stepper"})


def drive_and_motor(**keys: object) -> tuple[EmulatedCia402Drive, EmulatedMotor]:
    table = {"kind": "cia402", "interface": "virtual", "channel": "x", **keys}
    scene = Cia402Scene.model_validate(table)
    motor = EmulatedMotor(ACTUATOR, ACTUATOR.contact(LayerTable().layer()), scene.touch_m, 0)
    return EmulatedCia402Drive(scene, motor, (Mode.CYCLIC_VELOCITY,)), motor


def enabled(**keys: object) -> tuple[EmulatedCia402Drive, EmulatedMotor]:
    drive, motor = drive_and_motor(**keys)
    drive.select(Mode.CYCLIC_VELOCITY)
    for word in (Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE):
        drive.control(word, 0)
    assert drive.state is State.ENABLED
    return drive, motor


def test_statuswords_on_the_way_to_operation_enabled() -> None:
    drive, _ = drive_and_motor()
    words = [drive.statusword]
    for word in (Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE, Control.DISABLE_VOLTAGE):
        drive.control(word, 0)
        words.append(drive.statusword)
    assert words == [0x40, 0x31, 0x33, 0x37, 0x40]


def test_it_moves_in_operation_enabled_alone() -> None:
    drive, motor = drive_and_motor()
    drive.select(Mode.CYCLIC_VELOCITY)
    for word in (Control.ENABLE, Control.SHUTDOWN, Control.SWITCH_ON):
        drive.control(word, 1000)
        drive.advance(motor._now_ns + 10 * MS)
        assert motor.rate_hz == 0.0
    drive.control(Control.ENABLE, 1000)
    drive.advance(motor._now_ns + 10 * MS)
    assert motor.rate_hz == pytest.approx(1000.0)


def test_a_mode_it_does_not_have_is_not_taken() -> None:
    drive, _ = drive_and_motor()
    drive.select(Mode.PROFILE_VELOCITY)
    assert drive.mode == 0


def test_units_and_direction_of_what_it_says() -> None:
    drive, motor = enabled(inverted=True, velocity_scale=2.0, position_scale=4.0)
    drive.control(Control.ENABLE, 2000)
    drive.advance(100 * MS)
    assert motor.rate_hz == pytest.approx(-1000.0)
    assert motor.position_steps == pytest.approx(-100, abs=1)
    assert drive.velocity == pytest.approx(2000)
    assert drive.position == -4 * motor.position_steps


@pytest.mark.parametrize(
    ("inverted", "method"), [(False, NEGATIVE_SWITCH), (True, POSITIVE_SWITCH)]
)
def test_homing_onto_the_switch_away_from_the_finger(inverted: bool, method: int) -> None:
    drive, motor = enabled(inverted=inverted)
    drive.select(Mode.HOMING)
    drive.search_by(method, 8000, 400)
    drive.control(Control.START_HOMING, 0)
    drive.advance(2 * MS)
    assert not drive.statusword & HOMING_ATTAINED
    drive.advance(2_000 * MS)
    assert drive.statusword & HOMING_ATTAINED == HOMING_ATTAINED
    assert abs(motor.position_steps) <= 2


def test_here_is_home_and_another_method_is_an_error() -> None:
    drive, motor = enabled()
    drive.control(Control.ENABLE, 1000)
    drive.advance(100 * MS)
    drive.select(Mode.HOMING)
    drive.search_by(HERE, 0, 0)
    drive.control(Control.START_HOMING, 0)
    assert motor.position_steps == 0
    drive.control(Control.ENABLE, 0)
    drive.search_by(1, 0, 0)
    drive.control(Control.START_HOMING, 0)
    assert drive.statusword & HOMING_ERROR


@pytest.mark.parametrize(("option", "state"), [(3, State.SWITCH_ON_DISABLED), (1, State.FAULT)])
def test_at_rest_within_100_ms_of_the_last_heartbeat(option: int, state: State) -> None:
    drive, motor = enabled()
    drive.abort_option = option
    motor.set_watchdog(50 * MS)
    drive.control(Control.ENABLE, 20_000)
    for ms in range(1, 101):
        drive.advance(ms * MS)
    assert motor.rate_hz == 0.0
    assert drive.state is state
    assert drive.error_code == HEARTBEAT_ERROR


def test_a_fault_is_reset_by_a_rising_edge_alone() -> None:
    drive, motor = enabled()
    motor.fail("overtemperature")
    drive.control(Control.RESET_FAULT, 0)
    drive.advance(10 * MS)
    assert drive.state is State.FAULT
    drive.control(Control.RESET_FAULT, 0)
    assert drive.state is State.FAULT
    drive.control(Control.DISABLE_VOLTAGE, 0)
    drive.control(Control.RESET_FAULT, 0)
    assert drive.state is State.SWITCH_ON_DISABLED
    assert drive.error_code == 0


@pytest.mark.parametrize(("inverted", "limit"), [(False, NEGATIVE_LIMIT), (True, POSITIVE_LIMIT)])
def test_digital_inputs_report_the_home_switch_on_its_side(inverted: bool, limit: int) -> None:
    drive, motor = enabled(inverted=inverted)
    assert drive.digital_inputs == 0
    drive.control(Control.ENABLE, 8_000 if inverted else -8_000)
    drive.advance(2_000 * MS)
    assert motor.at_switch
    assert drive.digital_inputs == limit


def test_after_a_missed_heartbeat_it_moves_only_when_reset_and_enabled_again() -> None:
    drive, motor = enabled()
    motor.set_watchdog(50 * MS)
    drive.control(Control.ENABLE, 1_000)
    drive.advance(100 * MS)
    assert (drive.state, drive.error_code) == (State.FAULT, HEARTBEAT_ERROR)
    for word in (Control.ENABLE, Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE):
        drive.control(word, -1_000)
        drive.advance(motor._now_ns + 10 * MS)
        assert (drive.state, motor.rate_hz) == (State.FAULT, 0.0)
    drive.control(Control.RESET_FAULT, 0)
    for word in (Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE):
        drive.control(word, -1_000)
        drive.advance(motor._now_ns + 10 * MS)
    assert drive.state is State.ENABLED
    # The missed heartbeat was one event: none came since, and the drive obeys.
    drive.advance(motor._now_ns + 100 * MS)
    assert motor.rate_hz == pytest.approx(-1_000)


def test_a_quick_stop_on_a_missed_heartbeat_is_left_by_the_enable_sequence_alone() -> None:
    drive, motor = enabled()
    drive.abort_option = 3
    motor.set_watchdog(50 * MS)
    drive.control(Control.ENABLE, 1_000)
    for ms in range(1, 101):
        drive.advance(ms * MS)
    assert (drive.state, drive.error_code) == (State.SWITCH_ON_DISABLED, HEARTBEAT_ERROR)
    for word in (Control.SHUTDOWN, Control.SWITCH_ON, Control.ENABLE):
        drive.control(word, -1_000)
        drive.advance(motor._now_ns + 10 * MS)
    assert (drive.state, motor.rate_hz) == (State.ENABLED, pytest.approx(-1_000))
