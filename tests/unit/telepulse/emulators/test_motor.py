"""The motor of the emulated drives, in virtual time."""

import pytest

from display_node.plant.scene import StepperScene
from protocol.wire.description import LayerTable
from telepulse.emulators.motor import SWITCH_M, TICK_NS, EmulatedMotor, MotorState

TOUCH_M = 2e-3
SCENE = StepperScene.model_validate({"kind": "stepper"})
LAW = SCENE.contact(LayerTable().layer())
FASTEST_HZ = SCENE.max_speed_m_per_s / SCENE.step_m
MS = TICK_NS


def motor(**keys: object) -> EmulatedMotor:
    scene = StepperScene.model_validate({"kind": "stepper", **keys})
    return EmulatedMotor(scene, scene.contact(LayerTable().layer()), TOUCH_M, now_ns=0)


def test_it_keeps_the_limits_of_speed_and_acceleration() -> None:
    moved, rates = motor(), []
    moved.run(1e9)
    for ms in range(1, 41):
        moved.advance(ms * MS)
        rates.append(moved.rate_hz * SCENE.step_m)
    assert rates[0] == pytest.approx(SCENE.max_acceleration_m_per_s2 * 1e-3)
    assert max(rates) == pytest.approx(SCENE.max_speed_m_per_s)


def test_from_full_speed_with_a_silent_host_it_is_at_rest_within_100_ms() -> None:
    moved = motor()
    moved.set_watchdog(50 * MS)
    for ms in range(1, 31):
        moved.run(-FASTEST_HZ if ms < 2 else FASTEST_HZ / 40)
        moved.feed()
        moved.advance(ms * MS)
    assert moved.rate_hz > 0
    states: list[MotorState] = []
    moved.trace = states.append
    moved.advance((30 + 100) * MS)
    assert moved.tripped
    assert moved.rate_hz == 0.0
    # It was fed last at the beginning of the thirtieth ms, and was slow by then.
    rested_ns = next(state.time_ns for state in states if state.speed_m_per_s == 0.0)
    assert 29 + 50 < rested_ns / MS <= 29 + 50 + 5


def test_homing_finds_the_edge_of_the_switch() -> None:
    moved = motor()
    assert not moved.at_switch
    moved.home(8000.0, 400.0)
    moved.advance(2000 * MS)
    assert not moved.homing
    assert moved.rate_hz == 0.0
    # Left at 400 steps a second, seen every ms: within a step, and the way it takes to rest.
    assert moved.tip_m == pytest.approx(-TOUCH_M, abs=3 * SCENE.step_m)
    assert abs(moved.position_steps) <= 2


def test_the_home_switch_stops_what_runs_into_it() -> None:
    moved = motor()
    moved.run(-3000.0)
    moved.advance(3000 * MS)
    assert moved.at_switch
    assert moved.rate_hz == 0.0
    assert moved.tip_m > -TOUCH_M - SWITCH_M
    moved.run(1000.0)
    moved.advance(3500 * MS)
    assert not moved.at_switch


def test_it_presses_by_the_law_of_contact_and_stalls_beyond_its_thrust() -> None:
    moved = motor(thrust="1 N")
    moved.run(2000.0)
    ms = 0
    while not moved.fault:
        ms += 1
        moved.advance(ms * MS)
        assert moved.force_n == LAW.force(moved.tip_m)
    assert moved.fault == "stall"
    assert moved.force_n == pytest.approx(1.0, rel=0.05)
    moved.run(2000.0)
    stood_m = moved.tip_m
    moved.advance((ms + 100) * MS)
    assert moved.rate_hz == 0.0
    assert moved.tip_m == pytest.approx(stood_m, abs=20 * SCENE.step_m)


def test_a_command_counts_from_its_own_time_within_a_millisecond() -> None:
    moved = motor(max_acceleration="1e9 m/s^2")
    for at_ns in (0, 300_000, 1_900_000):
        moved.advance(at_ns)
        moved.run(10_000.0 if at_ns != 300_000 else 90_000.0)
    moved.advance(5 * MS)
    assert moved.position_steps == 3 + 1.6 * 90 + 3.1 * 10
