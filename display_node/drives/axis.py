"""One driven axis: what it moves, how far it may go, and how its drive counts.

Between the tip's metres and a drive's own integers.

Soft limits: how fast the tip may go so that it can still stop before the end of its travel.
"""

import math
from dataclasses import dataclass

from display_node.drives.scene import Cia402Scene, DriveScene
from display_node.plant.stepper import StepperScene
from protocol.tactile import ElasticLayer


class SoftLimits:
    """The part of the travel that may be used, and the speed that it leaves.

    lowest_m, furthest_m: ends of the travel from first touch. reaction_s: time from a command
    to what it does, beside the age of the position it is judged by.
    """

    def __init__(
        self, lowest_m: float, furthest_m: float, acceleration_m_per_s2: float, reaction_s: float
    ) -> None:
        self._lowest_m = lowest_m
        self._furthest_m = furthest_m
        self._acceleration = acceleration_m_per_s2
        self._reaction_s = reaction_s

    def bound(self, speed_m_per_s: float, position_m: float, age_s: float) -> float:
        """The wanted speed, or what is left of it near an end; 0 for no number.

        position_m was true age_s ago. Until the drive reacts the tip may go on at the full
        speed v, then it brakes: v t + v²/2a must not exceed the distance that is left. Since the
        position was heard the tip may have been faster than v, but not twice as fast: speeds so
        bounded fall by no more than a factor of e in a time of t, which is twice the age or more.
        """
        if speed_m_per_s > 0:
            return min(speed_m_per_s, self._fastest(self._furthest_m - position_m, age_s))
        if speed_m_per_s < 0:
            return -min(-speed_m_per_s, self._fastest(position_m - self._lowest_m, age_s))
        return 0.0

    def _fastest(self, distance_m: float, age_s: float) -> float:
        if not distance_m > 0:
            return 0.0
        blind_s, braking = 2 * age_s + self._reaction_s, self._acceleration
        return braking * (math.sqrt(blind_s * blind_s + 2 * distance_m / braking) - blind_s)


LARGEST = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Units:
    """How a drive counts.

    step_m: travel of one (micro)step. per_step: the drive's position units in one step.
    per_step_rate: its velocity units in one step a second. direction: 1 where the drive's
    positive goes into the finger, −1 where it goes away. home_m: where its zero is, from first
    touch.
    """

    step_m: float
    per_step: float
    per_step_rate: float
    direction: int
    home_m: float

    def velocity(self, speed_m_per_s: float) -> int:
        """A speed as the drive writes it, within 32 bits."""
        units = round(self.direction * speed_m_per_s / self.step_m * self.per_step_rate)
        return min(max(units, -LARGEST), LARGEST)

    def speed_m_per_s(self, velocity: int) -> float:
        """The speed that the drive's number stands for."""
        return self.direction * velocity / self.per_step_rate * self.step_m

    def position(self, position_m: float) -> int:
        """A tip position as the drive writes it, within 32 bits."""
        units = round(self.direction * (position_m - self.home_m) / self.step_m * self.per_step)
        return min(max(units, -LARGEST), LARGEST)

    def position_m(self, position: int) -> float:
        """The tip position that the drive's number stands for."""
        return self.direction * position / self.per_step * self.step_m + self.home_m


# Between a command and the motor's reaction.
REACTION_S = 2e-3
# So far from first touch nothing is felt of the tip; half the way home where that is shorter.
CLEAR_M = 0.5e-3


@dataclass(frozen=True, slots=True)
class Axis:
    """The mechanics of a drive; speeds in m/s, accelerations in m/s².

    search_s: how long it may take to home, there and back over the whole stroke. clear_m: where the
    tip is off the finger, from first touch.
    """

    units: Units
    travel: SoftLimits
    lowest_m: float
    furthest_m: float
    max_speed_m_per_s: float
    max_acceleration_m_per_s2: float
    microsteps: int
    search_s: float
    clear_m: float


def build_axis(
    scene: DriveScene, actuator: StepperScene, layer: ElasticLayer, force_limit_n: float
) -> Axis:
    """The axis of a scene's drive and actuator.

    It may go from home to where the model of contact says that the tip presses with the force
    limit (or the thrust, or to the stroke's end, or to `furthest`, whichever comes first).
    """
    pressing_m = actuator.contact(layer).position(min(actuator.thrust_n, force_limit_n))
    # Told by whole microsteps, it may be almost one further on than it says.
    furthest_m = min(actuator.stroke_m - scene.touch_m, pressing_m - actuator.step_m)
    if scene.furthest_m is not None:
        furthest_m = min(furthest_m, scene.furthest_m)
    units = Units(
        step_m=actuator.step_m,
        per_step=scene.position_scale if isinstance(scene, Cia402Scene) else 1.0,
        per_step_rate=scene.velocity_scale,
        direction=-1 if scene.inverted else 1,
        home_m=-scene.touch_m,
    )
    # This command may be our last, and then it counts until the drive's watchdog ends it.
    reaction_s = REACTION_S + scene.watchdog_ns * 1e-9
    return Axis(
        units=units,
        travel=SoftLimits(
            -scene.touch_m, furthest_m, actuator.max_acceleration_m_per_s2, reaction_s
        ),
        lowest_m=-scene.touch_m,
        furthest_m=furthest_m,
        max_speed_m_per_s=actuator.max_speed_m_per_s,
        max_acceleration_m_per_s2=actuator.max_acceleration_m_per_s2,
        microsteps=actuator.microsteps,
        search_s=5.0 + 2 * actuator.stroke_m / scene.homing_speed_m_per_s,
        clear_m=-min(CLEAR_M, scene.touch_m / 2),
    )
