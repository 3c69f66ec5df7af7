import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import SceneError
from pulse_drives.axis import LARGEST, Axis, Units, build_axis
from telepulse.emulators.motor import TICK_NS, EmulatedMotor
from tests.support.drive_benches import FORCE_LIMIT_N, LAYER, stepper, tmcl_scene

UNITS = Units(step_m=1e-6, per_step=4.0, per_step_rate=0.5, direction=-1, home_m=-2e-3)
# 1 mm/s of the usual stepper.
TOUCHING_HZ = 1_600.0


def to_touch(motor: EmulatedMotor, now_ns: int) -> int:
    """Move the tip off the finger, then to first touch; return the time of the touch."""
    for rate_hz in (-TOUCHING_HZ, TOUCHING_HZ):
        motor.run(rate_hz)
        while (motor.tip_m < 0) is (rate_hz > 0):
            now_ns += TICK_NS
            motor.advance(now_ns)
    motor.run(0.0)
    return now_ns


def test_speeds_and_positions_are_converted_to_units_and_direction_of_the_drive() -> None:
    assert UNITS.velocity(3e-3) == -1500
    assert UNITS.speed_m_per_s(-1500) == pytest.approx(3e-3)
    # Positions count from home, and metres from first touch.
    assert UNITS.position_m(0) == pytest.approx(-2e-3)
    assert UNITS.position_m(-8000) == pytest.approx(0.0)
    assert UNITS.position(0.0) == -8000


@given(st.floats(-1e6, 1e6))
def test_no_number_exceeds_32_bits(value: float) -> None:
    assert abs(UNITS.velocity(value)) <= LARGEST
    assert abs(UNITS.position(value)) <= LARGEST


AXIS = Axis(UNITS, -0.002, 0.003, 0.4, 20.0, 16, reaction_s=0.05, search_s=5.0, clear_m=-5e-4)
WATCHDOG_NS = 50_000_000


@given(wanted=st.floats(-1, 1), position_m=st.floats(-0.01, 0.01), age_s=st.floats(0, 0.1))
def test_a_bounded_speed_has_the_same_direction_and_is_no_faster(
    wanted: float, position_m: float, age_s: float
) -> None:
    bounded = AXIS.bounded(wanted, position_m, age_s)
    assert abs(bounded) <= abs(wanted)
    assert bounded * wanted >= 0


def test_beyond_an_end_only_the_return_is_permitted() -> None:
    assert AXIS.bounded(0.1, 0.0031, 0.0) == 0.0
    assert AXIS.bounded(-0.1, -0.0021, 0.0) == 0.0
    assert AXIS.bounded(-0.1, 0.0031, 0.0) < 0.0
    assert AXIS.bounded(0.1, -0.0021, 0.0) > 0.0


@pytest.mark.parametrize("speed", [math.nan, 0.0])
def test_a_speed_or_position_that_is_no_number_is_no_motion(speed: float) -> None:
    assert AXIS.bounded(speed, 0.0, 0.0) == 0.0
    assert AXIS.bounded(1.0, math.nan, 0.0) == 0.0


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize("age_ms", [0, 10, 40])
@pytest.mark.parametrize("killed_after_ms", [3, 10, 40, 100, 400])
def test_the_watchdog_stops_the_tip_within_its_travel_whenever_the_commands_end(
    killed_after_ms: int, age_ms: int, direction: int
) -> None:
    scene = tmcl_scene(port="x", watchdog="50 ms", touch="2 mm", reply_timeout="10 ms")
    actuator = stepper()
    axis = build_axis(scene, actuator, actuator.deepest_m(LAYER, FORCE_LIMIT_N))
    motor = EmulatedMotor(actuator, actuator.contact(LAYER), 2e-3, now_ns=0)
    began_ns = to_touch(motor, 0)
    motor.set_watchdog(WATCHDOG_NS)
    tips_m = [motor.tip_m]
    for tick in range(1, killed_after_ms + 200):
        if tick <= killed_after_ms:
            known_m = tips_m[max(0, len(tips_m) - 1 - age_ms)]
            wanted = direction * axis.max_speed_m_per_s
            speed = axis.bounded(wanted, known_m, age_ms * 1e-3)
            motor.run(axis.units.velocity(speed))
            motor.feed()
        motor.advance(began_ns + tick * TICK_NS)
        tips_m.append(motor.tip_m)
    assert motor.rate_hz == 0.0
    assert axis.lowest_m - actuator.step_m <= min(tips_m)
    assert max(tips_m) <= axis.furthest_m + actuator.step_m
    # The limit still permits a motion.
    assert max(abs(tip_m) for tip_m in tips_m) > 20e-6


def test_depths_count_from_a_finger_that_has_followed_the_tip() -> None:
    axis = build_axis(tmcl_scene(port="x", touch="5 mm"), stepper(), 2e-3)
    assert axis.bounded(1.0, -1e-3, 0.0, -3e-3) == 0.0
    assert axis.bounded(1.0, -1.5e-3, 0.0, -3e-3) == axis.bounded(1.0, 1.5e-3, 0.0)
    assert axis.bounded(-1.0, -1.5e-3, 0.0, -3e-3) == axis.bounded(-1.0, -1.5e-3, 0.0)
    assert axis.clear_of(-3e-3) == axis.clear_m - 3e-3
    # A withdrawal keeps some distance from home.
    assert axis.lowest_m < axis.clear_of(-1.0) < axis.clear_m


@pytest.mark.parametrize(
    ("motor", "homing", "refused"),
    [
        ({"max_speed": "4 mm/s"}, "5 mm/s", r"homing_speed is 5 mm/s, and .* max_speed 4 mm/s"),
        ({"max_speed": "0.3 mm/s"}, "0.3 mm/s", r"off the finger within 10 s from 2\.55 mm"),
        ({"max_acceleration": "0.1 m/s^2"}, "5 mm/s", r"off the finger within 8\.\d s"),
        ({"max_speed": "4 mm/s"}, "4 mm/s", ""),
    ],
)
def test_an_axis_that_is_too_slow_is_refused(
    motor: dict[str, str], homing: str, refused: str
) -> None:
    scene, actuator = tmcl_scene(port="x", homing_speed=homing), stepper(**motor)
    deepest_m = actuator.deepest_m(LAYER, FORCE_LIMIT_N)
    if not refused:
        assert build_axis(scene, actuator, deepest_m).off_s <= 1.0
        return
    with pytest.raises(SceneError, match=refused):
        build_axis(scene, actuator, deepest_m)
