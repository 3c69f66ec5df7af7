"""The local force loop: film → controller → drive → actuator, once a tick.

It closes here and nowhere else, so the network's delay cannot destabilise it.
"""

import math
from collections.abc import Callable

from display_node.control.controller import ControllerScene, StepperController, VoltageController
from display_node.control.feed_forward import ScrewPath
from display_node.control.margins import refuse_unstable
from display_node.control.observer import Observer
from display_node.plant.film import FeedbackFilm, FilmTable
from display_node.plant.second_order import SecondOrder, SecondOrderScene
from display_node.plant.stepper import Stepper, StepperScene
from protocol.errors import SceneError
from protocol.limits import LimitCounter
from protocol.tactile import ElasticLayer

# As a drive's by default.
WATCHDOG_S = 0.05


class ForceLoop:
    """Presses with the reference force, as the film under the finger tells it.

    horizon: how many ticks after the present one the reference must reach. plausible_n: a
    reading beyond this, to either side, is no reading of a force. lead_ns: how much later than
    now the reference begins, for an actuator that answers so late. output: of the controller at
    the last tick. at_end: counts the ticks at the end of the travel, None for an actuator that
    has none.
    """

    def __init__(
        self,
        controller: StepperController | VoltageController,
        drive: Callable[[float], float],
        film: FeedbackFilm,
        plausible_n: float,
        tick_s: float,
        lead_ns: int = 0,
        at_end: LimitCounter | None = None,
    ) -> None:
        self.lead_ns = lead_ns
        self.at_end = at_end
        self._plausible_n = plausible_n
        self._controller = controller
        self._drive = drive
        self._film = film
        self._watchdog_ticks = round(WATCHDOG_S / tick_s)
        self.output = 0.0
        self.horizon = controller.horizon
        self.felt_n = 0.0

    @property
    def at_film_range(self) -> LimitCounter | None:
        """The count of readings at the range of the film's ADC; None without an ADC."""
        return self._film.at_range

    @property
    def finger_stiffness(self) -> float | None:
        """See `Observer.finger_stiffness`; None without an observer."""
        controller = self._controller
        return controller.finger_stiffness if isinstance(controller, StepperController) else None

    def coast(self, ticks: int) -> None:
        """Ticks that were missed: the drive goes on as it was told last, until its watchdog
        brings it to rest."""
        told = min(ticks, self._watchdog_ticks)
        for _ in range(told):
            self._miss()
        if ticks > told:
            self.output = 0.0
            for _ in range(min(ticks - told, self._watchdog_ticks)):
                self._miss()

    def _miss(self) -> None:
        self.read_film()
        self._controller.skip(self.output)
        self.felt_n = self._drive(self.output)

    def read_film(self) -> float:
        """Return the film's reading of the felt force, in N. Call it once before each tick."""
        return self._film.read(self.felt_n)

    def tick(self, reference_n: list[float], reading_n: float) -> float:
        """Advance one tick towards the reference (now and the next `horizon` ticks); the felt
        force at its end."""
        if not -self._plausible_n <= reading_n <= self._plausible_n:
            reading_n = math.nan
        self.output = self._controller.output(reference_n, reading_n)
        self.felt_n = self._drive(self.output)
        return self.felt_n

    def shift(self, way_m: float) -> None:
        """Move the stepper's models on: it has gone so much further than the outputs led by this
        tick."""
        if isinstance(self._controller, StepperController):
            self._controller.shift(way_m)


def build_force_loop(
    controller: ControllerScene,
    actuator: SecondOrderScene | StepperScene,
    layer: ElasticLayer,
    film: FilmTable,
    force_limit_n: float,
    tick_s: float,
    actual: SecondOrderScene | StepperScene | None = None,
    slew_limit_n_per_s: float = math.inf,
    overforce: float = 1.08,
) -> ForceLoop:
    """The force loop of these parts.

    overforce: readings beyond so many times the force limit are passed over.

    actual: what the actuator really is, where that differs from what the controller takes it
    for. Raises SceneError where the scene's parts do not fit, and for a loop that is not stable.
    """
    if isinstance(actuator, SecondOrderScene) and (
        controller.feed_forward or controller.error == "position"
    ):
        raise SceneError(
            "[display] controller: feed_forward and error = 'position' need a stepper's contact"
            " law; this actuator is second_order"
        )
    plausible_n = overforce * force_limit_n
    refuse_unstable(controller, actuator, layer, film, force_limit_n, tick_s)
    if isinstance(actuator, StepperScene):
        lead_ns = actuator.latency_ns
        truth = actual if isinstance(actual, StepperScene) else actuator
        speed, stepper, drive = _stepper(
            controller, actuator, truth, layer, film, force_limit_n, slew_limit_n_per_s, tick_s
        )
        read = FeedbackFilm(film, tick_s)
        return ForceLoop(speed, drive, read, plausible_n, tick_s, lead_ns, stepper.at_end)
    truth_model = SecondOrder(actual if isinstance(actual, SecondOrderScene) else actuator, tick_s)
    voltage = VoltageController(
        controller,
        controller.pid(tick_s, actuator.voltage_limit),
        film.millivolts_per_newton,
        SecondOrder(actuator, tick_s),
    )
    return ForceLoop(voltage, truth_model.step, FeedbackFilm(film, tick_s), plausible_n, tick_s)


def _stepper(
    controller: ControllerScene,
    scene: StepperScene,
    actual: StepperScene,
    layer: ElasticLayer,
    film: FilmTable,
    force_limit_n: float,
    slew_limit_n_per_s: float,
    tick_s: float,
) -> tuple[StepperController, Stepper, Callable[[float], float]]:
    """Controller of a stepper, the stepper, and what its output does."""
    law = scene.contact(layer)
    stepper = Stepper(actual, actual.contact(layer), force_limit_n, tick_s)
    vco = scene.step_rate()
    latency_ticks = scene.ticks_to_reading(film.latency_ns, tick_s)
    observer = None
    if controller.observer is not None:
        at_once = scene.model_copy(update={"latency_ns": 0})
        twin = Stepper(at_once, law, force_limit_n, tick_s)
        observer = Observer(
            controller.observer, twin, law, film, scene.step_m, tick_s, latency_ticks
        )
    speed = StepperController(
        controller,
        controller.pid(tick_s, scene.max_speed_m_per_s),
        law,
        film.millivolts_per_newton,
        ScrewPath(scene, law, tick_s) if controller.feed_forward else None,
        observer,
        tick_s,
        slew_limit_n_per_s,
        latency_ticks,
        scene.backlash_m / 2,
    )

    def drive(output: float) -> float:
        rate_hz = vco.rate_hz(output)
        if observer is not None:
            observer.move(rate_hz)
        return stepper.step(rate_hz)

    return speed, stepper, drive
