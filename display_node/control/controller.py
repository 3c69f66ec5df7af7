"""Controllers: from the reference's next samples and the film's reading to an output.

The output is a signed speed in m/s for a stepper. For the second-order actuator of Dargahi et al.
(2008), the paper, it is a voltage in V.
"""

import math
from copy import deepcopy
from typing import ClassVar, Final

from display_node.control.feed_forward import ScrewPath
from display_node.control.observer import Observer
from display_node.control.scene import ControllerScene
from display_node.plant.contact import ContactLaw
from display_node.plant.filters import delay_line
from display_node.plant.scene import FilmTable, ForceModel, StepperScene
from display_node.plant.stepper import Stepper

# Time constants of decay, of the usual holding time and of the worst stall and the peak force.
USUAL_S: Final = 0.1
WORST_S: Final = 10.0
# Bound of the force during a stall, as a multiple of the recent peak of the reference.
HEADROOM: Final = 1.25
# Ticks over which an actuator's model predicts at most, in a time far below a tick.
MOST_HELD_TICKS: Final = 50
# Share of the slew limit for the path of a rotor that rings. The rest is for the loop's corrections
# where rotor or finger differ from the model.
SHAPED_SHARE: Final = 0.93


class HoldingTime:
    """Memory of how long commands were held recently.

    A drive keeps its last command until the next one. A command that is computed for one tick and
    held for many moves the tip too far, and the loop oscillates. So each command is computed for
    the recent usual holding time (decision 25).

    Attributes
    ----------
    held_s
        Recent mean holding time of commands in s, weighted by time; one tick without stalls.
    longest_s
        Recent longest one in s; 0 without stalls.
    """

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._usual = math.exp(-tick_s / USUAL_S)
        self._worst = math.exp(-tick_s / WORST_S)
        # Exponentially weighted sums of the holding times and of their squares, in ticks.
        self._holds = self._squares = 1 / (1 - self._usual)
        self.held_s, self.longest_s = tick_s, 0.0

    def tick(self, missed_ticks: int) -> None:
        """Advance one tick after missed ones."""
        if not (missed_ticks or self.longest_s):
            return
        hold = missed_ticks + 1
        self.longest_s *= self._worst
        if missed_ticks:
            self.longest_s = max(self.longest_s, hold * self._tick_s)
        self._holds = self._usual * self._holds + hold
        self._squares = self._usual * self._squares + hold * hold
        self.held_s = self._tick_s * self._squares / self._holds


class StallGuard:
    """Memory of recent stalls and forces, which limits each command for the next stall.

    If held for the longest recent time, a command must not press too hard (decision 25).

    Parameters
    ----------
    half_backlash_m
        Travel in m by which the screw is ahead of the tip while it presses.

    Attributes
    ----------
    peak_n
        Recent peak of the reference force in N.
    held_s
        See `HoldingTime`.
    limits
        Whether `fastest` bounds the speed: the host has stalled recently.
    """

    def __init__(self, law: ContactLaw, tick_s: float, half_backlash_m: float) -> None:
        self._law = law
        self._tick_s = tick_s
        self._half_backlash_m = half_backlash_m
        self._worst = math.exp(-tick_s / WORST_S)
        self._holding = HoldingTime(tick_s)
        self.peak_n = 0.0
        self.held_s = tick_s
        self.limits = False

    def tick(self, missed_ticks: int, wanted_n: float) -> None:
        """Advance one tick after missed ones; `wanted_n` is the reference force in N."""
        peak_n = self._worst * self.peak_n
        self.peak_n = wanted_n if wanted_n > peak_n else peak_n
        holding = self._holding
        if missed_ticks or holding.longest_s:
            holding.tick(missed_ticks)
            self.held_s = holding.held_s
            self.limits = holding.longest_s >= 2 * self._tick_s

    def fastest(self, screw_m: float) -> float:
        """Return the highest speed towards the finger in m/s, for the screw's position in m.

        It is infinite where the host has not stalled recently.
        """
        if not self.limits:
            return math.inf
        furthest_m = self._law.position(HEADROOM * self.peak_n) + self._half_backlash_m
        return max(0.0, furthest_m - screw_m) / self._holding.longest_s


class StepperController:
    """Controller of a stepper's speed.

    Parameters
    ----------
    law
        Contact law of the tip; an observer updates the finger's compliance in it.
    force_limit_n
        Greatest force of the observer's model of the actuator, in N.
    slew_limit_n_per_s
        Greatest slope of the force that is commanded.
    observer_gains
        Fixed gains of the observer, for `linear_loop`; its twin is linear then.

    Attributes
    ----------
    horizon
        Number of ticks after the present one that the reference must cover.
    shaper_delay_s
        Delay in s of the path's shaper, besides the actuator's latency; 0 without one.
    """

    STATE: ClassVar = ("_pid", "_observer")

    def __init__(
        self,
        scene: ControllerScene,
        actuator: StepperScene,
        law: ContactLaw,
        film: FilmTable,
        force_limit_n: float,
        tick_s: float,
        slew_limit_n_per_s: float = math.inf,
        observer_gains: tuple[float, list[float]] | None = None,
    ) -> None:
        lag_ticks = (actuator.latency_ns + film.latency_ns) * 1e-9 / tick_s
        self._pid = scene.pid(tick_s, actuator.max_speed_m_per_s)
        self._max_speed_m_per_s = actuator.max_speed_m_per_s
        self._guard = StallGuard(law, tick_s, actuator.backlash_m / 2)
        self._missed_ticks = 0
        self._law, self._tick_s = law, tick_s
        self._slew_limit_n_per_s = slew_limit_n_per_s
        self._force_limit_n = force_limit_n
        self._path = ScrewPath(actuator, law, tick_s) if scene.feed_forward else None
        self._observer: Observer | None = None
        if scene.observer is not None:
            at_once = actuator.model_copy(update={"latency_ns": 0})
            twin = Stepper(at_once, law, force_limit_n, tick_s, observer_gains is not None)
            self._observer = Observer(
                scene.observer, twin, law, film, actuator.step_m, tick_s, lag_ticks, observer_gains
            )
        self._last_reading_n = self._wanted_n = self._stiffest_n = 0.0
        self._late = delay_line(lag_ticks)
        path = self._path
        self.horizon = 1 if path is None else path.horizon
        self.shaper_delay_s = 0.0 if path is None else path.shaper_delay_s
        self._unit = None if scene.error == "position" else scene.error_per_newton(film)

    def output(self, reference_n: list[float], reading_n: float) -> float:
        """Return the speed for this tick in m/s, positive into the finger.

        Parameters
        ----------
        reference_n
            Reference force now and in each of the next `horizon` ticks, in N.
        reading_n
            The film's reading in N; NaN where it is missing or implausible.
        """
        path, observer, guard, law = self._path, self._observer, self._guard, self._law
        guard.tick(self._missed_ticks, reference_n[0])
        held_s, limits, feed = guard.held_s, guard.limits, 0.0
        if path is not None:
            if path.shaped:
                feed = self._advance_shaped(path, reference_n)
            else:
                feed = path.advance(reference_n, held_s)
        self._missed_ticks = 0
        if path is not None and observer is not None:
            observer.correct(reading_n)
            screw_m = observer.screw_m
            error, response = path.screw_m - screw_m, held_s
        else:
            if reading_n == reading_n:
                self._last_reading_n = reading_n
            last_n = self._last_reading_n
            screw_m = law.position(last_n) if self._unit is None or limits else 0.0
            # A reading is compared with the reference at the time of the command that caused it.
            self._wanted_n = reference_n[1]
            if path is not None and path.shaped:
                self._wanted_n = law.force(path.tip_m)
            wanted_n = self._wanted_n if self._late is None else self._late.step(self._wanted_n)
            if self._unit is None:
                # The path has this position already.
                given = path is not None and self._late is None
                wanted_m = path.tip_m if path is not None and given else law.position(wanted_n)
                error, response = wanted_m - screw_m, held_s
            else:
                error = self._unit * (wanted_n - last_n)
                response = self._unit * law.stiffness(last_n) * held_s
        if path is not None and path.further_m:
            error += response / held_s * path.further_m
        # The slew limit also holds while the loop catches up. A reading above the reference may
        # mean a stiffer contact, so it counts, but at most up to the recent peak.
        stiffest_n = reference_n[0]
        if reading_n > stiffest_n:
            stiffest_n = min(reading_n, guard.peak_n)
        self._stiffest_n = stiffest_n
        fastest = pressing = self._slew_limit_n_per_s / (law.stiffness(stiffest_n) or 1e-9)
        if limits:
            pressing = min(fastest, guard.fastest(screw_m))
        speed_m_per_s = self._pid.step(error, response, feed, lower=-fastest, upper=pressing)
        if observer is not None:
            observer.move(speed_m_per_s)
        return speed_m_per_s

    def _advance_shaped(self, path: ScrewPath, reference_n: list[float]) -> float:
        """Return the speed in m/s of a shaped path, for this tick."""
        law, held_s = self._law, self._guard.held_s
        stiffest_n = max(reference_n[0], reference_n[1], self._stiffest_n)
        slew_n_per_s = SHAPED_SHARE * self._slew_limit_n_per_s
        fastest = min(self._max_speed_m_per_s, slew_n_per_s / (law.stiffness(stiffest_n) or 1e-9))
        furthest_m = law.position(self._force_limit_n)
        return path.advance(reference_n, held_s, self._missed_ticks + 1, fastest, furthest_m)

    @property
    def finger_stiffness(self) -> float | None:
        """See `Observer.finger_stiffness`; None without an observer."""
        return None if self._observer is None else self._observer.finger_stiffness

    def skip(self, speed_m_per_s: float) -> None:
        """Account for a missed tick, in which the drive kept its speed."""
        self._missed_ticks += 1
        if self._path is not None:
            self._path.shift(speed_m_per_s * self._tick_s)
        if self._observer is not None:
            self._observer.skip()
            self._observer.move(speed_m_per_s)
        elif self._late is not None:
            self._late.step(self._wanted_n)

    def shift(self, travel_m: float) -> None:
        """Add a travel of the screw in m that the last output did not include."""
        if self._path is not None:
            self._path.shift(travel_m)
        if self._observer is not None:
            self._observer.shift(travel_m)


class VoltageController:
    """Controller of the voltage, or another output, that becomes the force of an actuator.

    model: of the actuator. limit: largest output.
    """

    STATE: ClassVar = ("_pid", "_twin")
    horizon = 1
    finger_stiffness: float | None = None

    def __init__(
        self,
        scene: ControllerScene,
        model: ForceModel,
        limit: float,
        film: FilmTable,
        tick_s: float,
    ) -> None:
        self._pid = scene.pid(tick_s, limit)
        self._twin = model
        self._unit = scene.error_per_newton(film)
        self._tick_s = tick_s
        self._holding = HoldingTime(tick_s)
        self._missed_ticks = 0

    def output(self, reference_n: list[float], reading_n: float) -> float:
        """Return the voltage for this tick in V; see `StepperController.output`."""
        twin, unit, holding = self._twin, self._unit, self._holding
        if reading_n == reading_n:  # else the model's own force is used
            twin.force_n = reading_n
        holding.tick(self._missed_ticks)
        # A force follows its voltage fast, so that the first late tick counts at once.
        held_ticks = max(1 + self._missed_ticks, round(holding.held_s / self._tick_s))
        self._missed_ticks = 0
        drift_n, response = twin.drift(), twin.response
        if held_ticks > 1:
            drift_n, response = self._held(min(held_ticks, MOST_HELD_TICKS))
        error = unit * (reference_n[1] - twin.force_n - drift_n)
        volts = self._pid.step(error, unit * response)
        twin.step(volts)
        return volts

    def _held(self, ticks: int) -> tuple[float, float]:
        """Return the force's change in N in some ticks without a voltage, and for each volt."""
        idle, driven = deepcopy(self._twin), deepcopy(self._twin)
        for _ in range(ticks):
            idle.step(0.0)
            driven.step(1.0)
        return idle.force_n - self._twin.force_n, driven.force_n - idle.force_n

    def skip(self, volts: float) -> None:
        """Account for a missed tick, in which the voltage was held."""
        self._missed_ticks += 1
        self._twin.step(volts)
