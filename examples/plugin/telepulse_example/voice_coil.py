"""An actuator: a voice coil, whose force follows the voltage with one time constant."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from protocol.config.quantities import Nanoseconds, Volts
from telepulse.plugins import ActuatorScene


class VoiceCoilScene(ActuatorScene):
    """The `actuator` table of kind "voice_coil"."""

    kind: Literal["voice_coil"]
    newtons_per_volt: Annotated[float, Field(gt=0, le=100)] = 0.5
    time_constant_ns: Annotated[Nanoseconds, Field(ge=100_000, le=1_000_000_000)] = 5_000_000
    voltage_limit_v: Annotated[Volts, Field(gt=0, le=100)] = 12.0

    @property
    def output_limit(self) -> float:
        """See `ActuatorScene.output_limit`."""
        return self.voltage_limit_v

    def build(self, tick_s: float) -> "VoiceCoil":
        """See `ActuatorScene.build`."""
        return VoiceCoil(self, tick_s)


class VoiceCoil:
    """A voice coil from tick to tick, integrated exactly for a held voltage."""

    STATE: ClassVar[tuple[str, ...]] = ("force_n",)

    def __init__(self, scene: VoiceCoilScene, tick_s: float) -> None:
        self._kept = math.exp(-tick_s * 1e9 / scene.time_constant_ns)
        self.response = scene.newtons_per_volt * (1 - self._kept)
        self.force_n = 0.0

    def drift(self) -> float:
        """See `ForceModel.drift`."""
        return (self._kept - 1) * self.force_n

    def step(self, output: float) -> float:
        """See `ForceModel.step`."""
        self.force_n = self._kept * self.force_n + self.response * output
        return self.force_n

    def place(self, force_n: float) -> None:
        """See `ForceModel.place`."""
        self.force_n = force_n
