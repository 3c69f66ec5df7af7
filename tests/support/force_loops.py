"""A shipped force loop at rest around a force, for tests of its linear model."""

from dataclasses import dataclass, field

from display_node.control.force_loop import ForceLoop, build_force_loop
from display_node.control.linear_loop import LinearLoop, linear_loop
from display_node.control.observer import DESIGN_FORCE_N
from display_node.control.scene import ControllerScene
from display_node.plant.film import FeedbackFilm
from display_node.plant.scene import FilmTable, SecondOrderScene, StepperScene
from protocol.tactile import ElasticLayer

TICK_S = 1e-3
LIMIT_N = 2.5
LAYER = ElasticLayer()
Table = dict[str, object]
# A lead so fine that microsteps have no effect.
FINE: Table = {"kind": "stepper", "lead": "1 nm", "microsteps": 256}


@dataclass(frozen=True)
class Case:
    """A controller, an actuator and a film, as tables of a scene."""

    controller: Table
    actuator: Table = field(default_factory=lambda: FINE)
    film: Table = field(default_factory=dict)

    @property
    def scenes(self) -> tuple[ControllerScene, SecondOrderScene | StepperScene, FilmTable]:
        kind = StepperScene if self.actuator["kind"] == "stepper" else SecondOrderScene
        return (
            ControllerScene.model_validate(self.controller),
            kind.model_validate(self.actuator),
            FilmTable.model_validate(self.film),
        )

    def linear(self, force_n: float = DESIGN_FORCE_N) -> LinearLoop:
        controller, actuator, film = self.scenes
        return linear_loop(controller, actuator, LAYER, film, TICK_S, force_n)

    @property
    def newtons_per_unit(self) -> float:
        """Force in N at the design force that one unit of the linear loop stands for."""
        _, actuator, _ = self.scenes
        if isinstance(actuator, SecondOrderScene):
            return 1.0
        return actuator.contact(LAYER).stiffness(DESIGN_FORCE_N)


class Shipped:
    """The loop that a case's scene builds, with the design force as its reference.

    Its film has the case's filter, but no noise or converter. travel: the actuator's travel over
    the travel that the controller assumes.
    """

    def __init__(self, case: Case, travel: float = 1.0) -> None:
        controller, actuator, film = case.scenes
        actual = None
        if isinstance(actuator, StepperScene):
            actual = actuator.model_copy(update={"lead_m": travel * actuator.lead_m})
        self.loop: ForceLoop = build_force_loop(
            controller, actuator, LAYER, film, LIMIT_N, TICK_S, actual
        )
        quiet = film.model_copy(update={"noise_n": 0.0, "adc_bits": None})
        self._film = FeedbackFilm(quiet, TICK_S)

    def tick(self, reference_n: float = DESIGN_FORCE_N, noise_n: float = 0.0) -> float:
        """Return the felt force after a tick whose reading is wrong by `noise_n`."""
        reading_n = self._film.read(self.loop.felt_n) + noise_n
        return self.loop.tick([reference_n] * (self.loop.horizon + 1), reading_n)

    def settled(self, ticks: int = 1000) -> "Shipped":
        for _ in range(ticks):
            self.tick()
        return self
