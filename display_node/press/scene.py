"""The `press` table of a display: the sensor of the finger's press, and its limits."""

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from display_node.press.finger_press import PressLimits
from protocol.config.kinds import OfKind
from protocol.config.quantities import (
    Name,
    Nanoseconds,
    Newtons,
    NewtonsPerMetre,
    NewtonsPerSecond,
)
from protocol.config.scene import Section
from protocol.wire.description import HOLD_DOWN
from pulse_sensors.sensor import SENSORS, SensorScene, one_force


class SyntheticFingerScene(Section):
    """The `sensor` table of kind "finger": a modelled finger, for demonstrations.

    levels: forces that it presses with in turn, each for the time `every`. stiffness: of finger and
    hand. pulse_share: share of the rendered pulse in the reading.
    """

    kind: Literal["finger"]
    levels_n: Annotated[
        tuple[Annotated[Newtons, Field(ge=0, le=10)], ...], Field(min_length=1, max_length=64)
    ] = (0.6, 1.2, 0.9, 1.5)
    every_ns: Annotated[Nanoseconds, Field(ge=500_000_000, le=600_000_000_000)] = 4_000_000_000
    stiffness_n_per_m: Annotated[NewtonsPerMetre, Field(ge=0, le=1e4)] = 300.0
    pulse_share: Annotated[float, Field(ge=0, le=3)] = 1.0
    noise_n: Annotated[Newtons, Field(ge=0, le=1)] = 2e-3


class PressScene(Section):
    """The `press` table: the press of the first contactor's finger is sent to the wrist.

    sensor: what measures the static force of the finger; kinds as of other sensors, and "finger".
    channel: the stream's channel of the load cell at the wrist. force_limit and slew_limit: of the
    set-points. connections: number of TCP connections over which the set-points go in turns; with
    0, they go over that of all other requests. film_reads_press: whether a real film under the
    finger measures its static force, and not only the pulse.
    """

    sensor: Annotated[
        SensorScene | SyntheticFingerScene,
        OfKind(SENSORS, also={"finger": SyntheticFingerScene}),
        AfterValidator(one_force),
    ]
    channel: Name = HOLD_DOWN
    force_limit_n: Annotated[Newtons, Field(gt=0, le=10)] = 3.0
    slew_limit_n_per_s: Annotated[NewtonsPerSecond, Field(gt=0, le=100)] = 20.0
    connections: Annotated[int, Field(strict=True, ge=0, le=32)] = 16
    film_reads_press: bool = False

    @property
    def live_sensor(self) -> SensorScene | None:
        """The table of a live sensor; None for a modelled finger."""
        return self.sensor if isinstance(self.sensor, SensorScene) else None

    @property
    def finger(self) -> SyntheticFingerScene | None:
        """The table of a modelled finger; None for a live sensor."""
        return None if isinstance(self.sensor, SensorScene) else self.sensor

    def limits(self) -> PressLimits:
        """Return the limits that the table describes."""
        return PressLimits(self.force_limit_n, self.slew_limit_n_per_s)
