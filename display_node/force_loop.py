"""The local force loop: controller → drive → actuator → film, once a tick.

It closes here and nowhere else, so the network's delay cannot destabilise it.
"""

from collections.abc import Callable

from display_node.actuators.second_order import SecondOrder, SecondOrderScene
from display_node.actuators.stepper import Stepper, StepperScene
from display_node.controller import Controller, ControllerScene, Pid
from display_node.step_rate import StepRate
from protocol.errors import SceneError
from protocol.tactile import ElasticLayer, Film

WATCHDOG_S = 0.1


class ForceLoop:
    """Presses with the reference force, as the film under the finger tells it."""

    def __init__(
        self, controller: Controller, drive: Callable[[float], float], film: Film, tick_s: float
    ) -> None:
        self._controller = controller
        self._drive = drive
        self._volts_per_newton = film.volts_per_newton
        self._watchdog_ticks = round(WATCHDOG_S / tick_s)
        self._output = 0.0
        self.felt_n = 0.0

    def coast(self, ticks: int) -> None:
        """Ticks that were missed: the drive goes on as it was told last, until its watchdog
        brings it to rest."""
        told = min(ticks, self._watchdog_ticks)
        for _ in range(told):
            self.felt_n = self._drive(self._output)
        if ticks > told:
            self._output = 0.0
            for _ in range(min(ticks - told, self._watchdog_ticks)):
                self.felt_n = self._drive(0.0)

    def tick(self, reference_n: list[float]) -> float:
        """Advance one tick towards the reference (now and a tick later); the felt force."""
        film_volts = self.felt_n * self._volts_per_newton
        self._output = self._controller.output(reference_n, film_volts)
        self.felt_n = self._drive(self._output)
        return self.felt_n


def build_force_loop(
    controller: ControllerScene,
    actuator: SecondOrderScene | StepperScene,
    layer: ElasticLayer,
    film: Film,
    force_limit_n: float,
    tick_s: float,
) -> ForceLoop:
    """The force loop that a scene names. Raises SceneError where its parts do not fit."""
    if isinstance(actuator, StepperScene):
        law = actuator.contact(layer)
        stepper = Stepper(actuator, law, force_limit_n, tick_s)
        vco = StepRate(
            1 / actuator.step_m, actuator.max_speed_m_per_s / actuator.step_m, controller.dead_band
        )
        pid = Pid(controller, tick_s, limit=actuator.max_speed_m_per_s)
        return ForceLoop(
            Controller(controller, pid, film, law, tick_s),
            lambda output: stepper.step(vco.command(output)),
            film,
            tick_s,
        )
    if controller.feed_forward or controller.error == "position":
        raise SceneError(
            "[display] controller: feed_forward and error = 'position' need a stepper's contact"
            " law; this actuator is second_order"
        )
    pid = Pid(controller, tick_s, limit=actuator.voltage_limit)
    model = SecondOrder(actuator, tick_s)
    return ForceLoop(Controller(controller, pid, film, None, tick_s), model.step, film, tick_s)
