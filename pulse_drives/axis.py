"""One driven axis: its travel with soft limits, its greatest speed, and the drive's units.

`Units` converts between the tip's metres and the drive's integers.
"""

import math
from dataclasses import dataclass

from protocol.errors import SceneError
from pulse_drives.scene import DriveScene, MotorScene
from pulse_drives.withdrawal import CONFIRMED_M, FAST_M_PER_S, SLOW_M_PER_S

# Positions and velocities of a drive have 32 bits.
LARGEST = 2**31 - 1
# Time from a command to the motor's reaction.
REACTION_S = 2e-3
# At this distance from first touch (or half the distance to home, if less) the tip is not felt.
CLEAR_M = 0.5e-3
# An axis that takes longer to leave the finger is refused.
OFF_WITHIN_S = 1.0


@dataclass(frozen=True, slots=True)
class Units:
    """A drive's units.

    Attributes
    ----------
    step_m
        Travel of one (micro)step in m.
    per_step
        The drive's position units in one step.
    per_step_rate
        The drive's velocity units in one step a second.
    direction
        1 where the drive's positive direction leads into the finger, −1 where it leads away.
    home_m
        The drive's zero, in m from first touch.
    """

    step_m: float
    per_step: float
    per_step_rate: float
    direction: int
    home_m: float

    def velocity(self, speed_m_per_s: float) -> int:
        """Return a speed in the drive's units, within 32 bits."""
        units = round(self.direction * speed_m_per_s / self.step_m * self.per_step_rate)
        return min(max(units, -LARGEST), LARGEST)

    def speed_m_per_s(self, velocity: int) -> float:
        """Return the speed in m/s of a velocity in the drive's units."""
        return self.direction * velocity / self.per_step_rate * self.step_m

    def position(self, position_m: float) -> int:
        """Return a tip position in the drive's units, within 32 bits."""
        units = round(self.direction * (position_m - self.home_m) / self.step_m * self.per_step)
        return min(max(units, -LARGEST), LARGEST)

    def position_m(self, position: int) -> float:
        """Return the tip position in m of a position in the drive's units."""
        return self.direction * position / self.per_step * self.step_m + self.home_m


@dataclass(frozen=True, slots=True)
class Axis:
    """The mechanics of a drive; positions in m from first touch.

    Attributes
    ----------
    lowest_m, furthest_m
        Ends of the travel: home, and the greatest depth.
    reaction_s
        Longest time in s for which the last command can act: reaction plus watchdog, without the
        age of the position.
    search_s
        Greatest duration of the search for home, there and back over the whole stroke.
    clear_m
        Position where the tip is off the finger; negative.
    """

    units: Units
    lowest_m: float
    furthest_m: float
    max_speed_m_per_s: float
    max_acceleration_m_per_s2: float
    microsteps: int
    reaction_s: float
    search_s: float
    clear_m: float

    @property
    def off_s(self) -> float:
        """Time in s in which a withdrawal takes the tip from its greatest depth off the finger."""
        slow = min(SLOW_M_PER_S, self.max_speed_m_per_s)
        fast = min(FAST_M_PER_S, self.max_speed_m_per_s)
        # Turning round takes a ramp down and one up.
        turn_s = 2 * self.max_speed_m_per_s / self.max_acceleration_m_per_s2
        away_m = max(self.furthest_m - self.clear_m - CONFIRMED_M, 0.0)
        return turn_s + CONFIRMED_M / slow + away_m / fast

    def clear_of(self, origin_m: float) -> float:
        """Return the position where the tip is off a finger that begins at `origin_m`."""
        return max(self.clear_m + origin_m, self.lowest_m - 0.5 * self.clear_m)

    def bounded(
        self, speed_m_per_s: float, position_m: float, age_s: float, origin_m: float = 0.0
    ) -> float:
        """Return the speed in m/s that still stops before an end of the travel; 0 for NaN.

        origin_m: position of the finger, from which the greatest depth counts.

        Until the drive reacts, for a time t, the tip may move at the full speed v; then it brakes.
        So v t + v²/2a must not exceed the remaining distance. Since the position was reported,
        age_s ago, the tip may have been faster than v, but not twice as fast. Bounded speeds
        fall by at most a factor of e in a time t. t contains twice the age, so within the age they
        fall by at most √e, which is less than 2.
        """
        to_end_m = position_m - self.lowest_m
        if speed_m_per_s > 0:
            to_end_m = self.furthest_m + origin_m - position_m
        if not (abs(speed_m_per_s) > 0 and to_end_m > 0):
            return 0.0
        late_s, braking = 2 * age_s + self.reaction_s, self.max_acceleration_m_per_s2
        fastest = braking * (math.sqrt(late_s * late_s + 2 * to_end_m / braking) - late_s)
        return min(max(speed_m_per_s, -fastest), fastest)


def build_axis(scene: DriveScene, motor: MotorScene, deepest_m: float) -> Axis:
    """Return the axis of a scene's drive and motor.

    Its travel begins at home. It ends at `deepest_m`, at the stroke's end, or at `furthest`,
    whichever comes first. Raises SceneError for a motor that is slower than its search for home, or
    that does not take the tip off the finger in time.
    """
    # Positions count whole microsteps, so the tip may be almost one microstep further.
    ends_m = [motor.stroke_m - scene.touch_m, deepest_m - motor.step_m]
    if scene.homing_speed_m_per_s > motor.max_speed_m_per_s:
        raise SceneError(
            f"drive.homing_speed is {scene.homing_speed_m_per_s * 1e3:.4g} mm/s, and the actuator's"
            f" max_speed {motor.max_speed_m_per_s * 1e3:.4g} mm/s: home more slowly, or correct"
            " max_speed"
        )
    axis = Axis(
        units=Units(
            step_m=motor.step_m,
            per_step=scene.units_per_step,
            per_step_rate=scene.velocity_scale,
            direction=scene.direction,
            home_m=-scene.touch_m,
        ),
        lowest_m=-scene.touch_m,
        furthest_m=min(ends_m + ([] if scene.furthest_m is None else [scene.furthest_m])),
        max_speed_m_per_s=motor.max_speed_m_per_s,
        max_acceleration_m_per_s2=motor.max_acceleration_m_per_s2,
        microsteps=motor.microsteps,
        # If no command follows, the last one acts until the drive's watchdog ends it.
        reaction_s=REACTION_S + scene.watchdog_ns * 1e-9,
        search_s=5.0 + 2 * motor.stroke_m / scene.homing_speed_m_per_s,
        clear_m=-min(CLEAR_M, scene.touch_m / 2),
    )
    if axis.off_s > OFF_WITHIN_S:
        raise SceneError(
            f"actuator.max_speed and max_acceleration take the tip off the finger within"
            f" {axis.off_s:.2g} s from {axis.furthest_m * 1e3:.3g} mm, and after a fault it must be"
            f" off within {OFF_WITHIN_S:g} s: allow more speed, or less depth (drive.furthest,"
            " safety.force_limit)"
        )
    return axis
