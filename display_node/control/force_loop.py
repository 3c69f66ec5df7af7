"""The local force loop: film → controller → actuator, once a tick.

The loop closes inside the display node only, so the network's delay cannot destabilise it.
"""

import math
from collections.abc import Callable

from display_node.control.controller import StepperController, VoltageController
from display_node.control.linear_loop import refuse_unstable
from display_node.control.scene import ControllerScene
from display_node.plant.film import FilmModel
from display_node.plant.scene import ActuatorScene, FilmTable
from display_node.plant.stepper import Stepper
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer
from protocol.ticks import LimitCounter

# Time for which a modelled actuator without a drive keeps its last output: a drive's by default.
HELD_S = 0.05
# After this time without a command after that, the loop is at rest.
SETTLED_S = 0.05


class ForceLoop:
    """A controller, the model of its actuator and the film under the finger.

    Parameters
    ----------
    actuator
        Function that runs the actuator's model for a tick under the controller's output, and
        returns the felt force in N: `Stepper.step`, or `ForceModel.step`.
    overforce_n
        Readings beyond ±overforce_n are ignored. In a display they are faults (`ForceBounds`).
    held_s
        Time in s for which the actuator keeps an output without a command; then it stops.
    actuation_delay_ns
        Latency of the actuator and delay of its shaper in ns: the reference must begin this much
        later than now.
    at_end
        Counter of the ticks at the end of the travel; None for an actuator without an end.

    Attributes
    ----------
    horizon
        Number of ticks after the present one that the reference must cover.
    held_ticks
        Number of ticks for which the actuator keeps an output, that of the command included.
    felt_n
        Felt force at the last tick's end, in N, by the model of the actuator.
    at_film_range
        Counter of readings at the range of the film's ADC; None without an ADC.
    """

    def __init__(
        self,
        controller: StepperController | VoltageController,
        actuator: Callable[[float], float],
        film: FilmModel,
        overforce_n: float,
        tick_s: float,
        held_s: float = HELD_S,
        actuation_delay_ns: int = 0,
        at_end: LimitCounter | None = None,
    ) -> None:
        self.actuation_delay_ns = actuation_delay_ns
        self.at_end = at_end
        self.at_film_range = film.at_range
        self._overforce_n = overforce_n
        self._controller = controller
        self._actuator: Callable[[float], float] | None = actuator
        self._film = film
        self.held_ticks = max(1, round(held_s / tick_s))
        self._settled_ticks = self.held_ticks + round(SETTLED_S / tick_s)
        self._output = 0.0
        self.horizon = controller.horizon
        self.felt_n = 0.0

    @property
    def counters(self) -> dict[str, LimitCounter]:
        """Counters of the limits that the models have, by their names in `Limits`."""
        counters = {"film": self.at_film_range, "travel": self.at_end}
        return {name: counter for name, counter in counters.items() if counter is not None}

    @property
    def finger_stiffness(self) -> float | None:
        """See `Observer.finger_stiffness`; None without an observer."""
        return self._controller.finger_stiffness

    def coast(self, ticks: int) -> None:
        """Run missed ticks: the actuator keeps its last output for `held_s`, then it stops."""
        for missed in range(min(ticks, self._settled_ticks)):
            if missed + 1 == self.held_ticks:
                self._output = 0.0
            self._controller.skip(self._output)
            if self._actuator is not None:
                self.read_film()
                self.move()

    def leave_to_bench(self) -> None:
        """Run no model of actuator and film any more: a real bench takes their place."""
        self._actuator = None

    def read_film(self) -> float:
        """Return the modelled film's reading in N. Call it once before each tick."""
        return self._film.read(self.felt_n)

    def output(self, reference_n: list[float], reading_n: float) -> float:
        """Return the controller's output for a tick: m/s of a stepper, V of eq 22.

        Call `move` after it, when the actuator has been commanded.

        Parameters
        ----------
        reference_n
            Reference force now and in each of the next `horizon` ticks, in N.
        reading_n
            The film's reading in N.
        """
        if not -self._overforce_n <= reading_n <= self._overforce_n:
            reading_n = math.nan
        self._output = output = self._controller.output(reference_n, reading_n)
        return output

    def move(self) -> None:
        """Run the model of the actuator for a tick under the last output."""
        if self._actuator is not None:
            self.felt_n = self._actuator(self._output)

    def tick(self, reference_n: list[float], reading_n: float) -> float:
        """Move a modelled actuator by the controller's output, and return that."""
        output = self.output(reference_n, reading_n)
        self.move()
        return output

    def shift(self, travel_m: float) -> None:
        """Add a travel of the screw in m that the outputs until this tick did not include."""
        if isinstance(self._controller, StepperController):
            self._controller.shift(travel_m)


def build_force_loop(
    controller: ControllerScene,
    actuator: ActuatorScene,
    layer: ElasticLayer,
    film: FilmTable,
    force_limit_n: float,
    tick_s: float,
    actual: ActuatorScene | None = None,
    slew_limit_n_per_s: float = math.inf,
    overforce: float = 1.08,
    held_s: float = HELD_S,
) -> ForceLoop:
    """Build a force loop from the tables of a scene.

    Parameters
    ----------
    controller, actuator, layer, film
        The parts, as the controller models them.
    force_limit_n
        Greatest force at rest, in N.
    actual
        The simulated actuator, if it differs from the controller's model.
    slew_limit_n_per_s
        Greatest slope of the commanded force.
    overforce
        Readings beyond this multiple of the force limit are ignored.
    held_s
        Time in s for which the actuator keeps an output without a command.

    Raises
    ------
    SceneError
        Where the parts do not fit, or the loop is not stable enough.
    """
    needs_law = controller.feed_forward or controller.error == "position"
    stepper_scene = actuator.stepper
    if needs_law and stepper_scene is None:
        raise SceneError(
            "[display] controller: feed_forward and error = 'position' need a stepper's contact"
            f" law; this actuator is {actuator.kind}"
        )
    refuse_unstable(controller, actuator, layer, film, force_limit_n, tick_s)
    reading, overforce_n = FilmModel(film, tick_s), overforce * force_limit_n
    if stepper_scene is None:
        plant = (actual or actuator).build(tick_s)
        voltage = VoltageController(
            controller, actuator.build(tick_s), actuator.output_limit, film, tick_s
        )
        return ForceLoop(voltage, plant.step, reading, overforce_n, tick_s, held_s)
    truth = stepper_scene if actual is None or actual.stepper is None else actual.stepper
    # The VCO is that of the controller's electronics, so of its model: where the actual screw has
    # another pitch, it moves at another speed than the commanded one, as on a real bench.
    stepper = Stepper(
        truth,
        truth.contact(layer),
        force_limit_n,
        tick_s,
        steps_per_m=stepper_scene.steps_per_m,
    )
    law = stepper_scene.contact(layer)
    speed = StepperController(
        controller, stepper_scene, law, film, force_limit_n, tick_s, slew_limit_n_per_s
    )
    delay_ns = stepper_scene.latency_ns + round(speed.shaper_delay_s * 1e9)
    return ForceLoop(
        speed,
        stepper.step,
        reading,
        overforce_n,
        tick_s,
        held_s,
        delay_ns,
        stepper.at_end,
    )
