"""A bench that can be pressed with, tick by tick: here the scene's models, in virtual time."""

from typing import NamedTuple, Protocol

from display_node.plant.film import FeedbackFilm
from display_node.plant.second_order import SecondOrder, SecondOrderScene
from display_node.plant.stepper import Stepper, StepperScene
from display_node.scene import DisplayScene


class FilmSample(NamedTuple):
    """One reading of the film under the finger, and when it was taken."""

    time_s: float
    force_n: float


class Rig(Protocol):
    """An actuator with a film under it.

    It is told a speed in m/s, positive into the finger; the paper's second-order model a
    voltage in V.
    """

    @property
    def tick_s(self) -> float:
        """How long a tick is."""

    def tick(self, output: float) -> tuple[float, list[FilmSample]]:
        """Hold an output for one tick: when it was told, and what the film said until its end."""

    def retreat(self) -> None:
        """Go back the way it came, to where it began, and rest there."""


class ModelRig:
    """The scene's actuator and film as models; time is counted in ticks."""

    def __init__(self, scene: DisplayScene) -> None:
        self.tick_s = scene.tick_ns * 1e-9
        self._film = FeedbackFilm(scene.film, self.tick_s)
        self._actuator: Stepper | SecondOrder
        if isinstance(scene.actuator, SecondOrderScene):
            self._actuator = SecondOrder(scene.actuator, self.tick_s)
        else:
            self._actuator = _stepper(scene, scene.actuator, self.tick_s)
            self._vco = scene.actuator.step_rate()
        self._ticks = 0

    def tick(self, output: float) -> tuple[float, list[FilmSample]]:
        """See `Rig.tick`."""
        if isinstance(self._actuator, SecondOrder):
            self._actuator.step(output)
        else:
            self._actuator.step(self._vco.command(output))
        told_s = self._ticks * self.tick_s
        self._ticks += 1
        reading_n = self._film.read(self._actuator.force_n)
        return told_s, [FilmSample(self._ticks * self.tick_s, reading_n)]

    def retreat(self) -> None:
        """See `Rig.retreat`; nothing is pressed by a model."""


def _stepper(scene: DisplayScene, actuator: StepperScene, tick_s: float) -> Stepper:
    law = actuator.contact(scene.layer.layer())
    return Stepper(actuator, law, scene.safety.force_limit_n, tick_s)
