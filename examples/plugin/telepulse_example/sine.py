"""A source: a sine of force, for the frequency response of a display."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from protocol.config.quantities import Hertz, Newtons
from telepulse.plugins import Channel, SampleSource, SourceContext, SourceScene


class SineScene(SourceScene):
    """The `source` table of kind "sine"."""

    kind: Literal["sine"]
    rate_hz: Annotated[Hertz, Field(ge=100, le=10_000)] = 1000.0
    frequency_hz: Annotated[Hertz, Field(gt=0, le=50)] = 1.25
    amplitude_n: Annotated[Newtons, Field(ge=0, le=1)] = 0.1
    mean_n: Annotated[Newtons, Field(ge=0, le=1)] = 0.3

    @model_validator(mode="after")
    def _presses(self) -> "SineScene":
        if self.amplitude_n > self.mean_n:
            raise ValueError("amplitude must be at most mean: a finger cannot be pulled")
        return self

    def build(self, context: SourceContext) -> "Sine":
        """See `SourceScene.build`."""
        return Sine(self)


class Sine(SampleSource):
    """A sine of force on one channel."""

    channels = (Channel("sine"),)

    def __init__(self, scene: SineScene) -> None:
        self._scene = scene
        self.period_ns = round(1e9 / scene.rate_hz)
        self._taken = 0

    def take(self, count: int) -> NDArray[np.float64]:
        """See `SampleSource.take`."""
        scene, numbers = self._scene, np.arange(self._taken, self._taken + count)
        self._taken += count
        phase = 2 * np.pi * scene.frequency_hz * numbers * self.period_ns * 1e-9
        force_n: NDArray[np.float64] = scene.mean_n + scene.amplitude_n * np.sin(phase)
        return force_n[:, np.newaxis]
