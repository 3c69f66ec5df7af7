"""The tables of the controller, its observer, and safety."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from display_node.control.pid import Pid
from display_node.plant.scene import FilmTable
from protocol.config.quantities import Hertz, Metres, Nanoseconds, Newtons, NewtonsPerSecond, Ratio
from protocol.config.scene import Section


class ObserverScene(Section):
    """The `observer` table.

    wander: RMS motion of the finger under the tip in 1 s. softening: RMS change of its compliance
    in 1 s, as a share; 0 keeps the scene's compliance.
    """

    wander_m: Annotated[Metres, Field(gt=0, le=0.1)]
    softening: Annotated[Ratio, Field(ge=0, le=1)] = 0.01


class ControllerScene(Section):
    """The `controller` table.

    error: quantity of the PID's error. "force" is in N. "millivolts" is the film's voltage by
    eq 21, with which the paper's gains make the force follow a pulse. "position" is in m, by the
    inverse contact law; the loop's gain is then the same at every force. feed_forward: drive the
    reference's own motion without waiting for an error (stepper only). observer: estimate the felt
    force by a model of actuator and film (stepper only, error "position").
    derivative_filter: corner of the derivative's low-pass. dead_band: an error within ±dead_band,
    in the error's unit, counts as 0.
    """

    kp: Annotated[float, Field(ge=0, le=1e12)]
    ki: Annotated[float, Field(ge=0, le=1e12)] = 0.0
    kd: Annotated[float, Field(ge=0, le=1e12)] = 0.0
    derivative_filter_hz: Annotated[Hertz, Field(gt=0)] = 100.0
    error: Literal["force", "millivolts", "position"] = "force"
    feed_forward: bool = False
    observer: ObserverScene | None = None
    dead_band: Annotated[float, Field(ge=0)] = 0.0

    @model_validator(mode="after")
    def _observer_fits(self) -> "ControllerScene":
        if self.observer is not None and not (self.feed_forward and self.error == "position"):
            raise ValueError('an observer needs error = "position" and feed_forward = true')
        return self

    def pid(self, tick_s: float, limit: float) -> Pid:
        """Return the PID with these gains, whose output is within ±limit."""
        filter_hz, dead_band = self.derivative_filter_hz, self.dead_band
        return Pid(self.kp, self.ki, self.kd, filter_hz, tick_s, limit, dead_band)

    def error_per_newton(self, film: FilmTable) -> float:
        """Return the error of 1 N in the error's unit, which is not "position"."""
        return film.millivolts_per_newton if self.error == "millivolts" else 1.0


class SafetyScene(Section):
    """The `safety` table; the default force limit is the range of Fig. 4 of Dargahi et al. (2008).

    overforce: felt force, as a multiple of the limit, above which it is a fault. feedback_within:
    longest time without a sample of a real film; then the film counts as lost.
    """

    force_limit_n: Annotated[Newtons, Field(gt=0, le=100)] = 2.5
    slew_limit_n_per_s: Annotated[NewtonsPerSecond, Field(gt=0)] = 50.0
    stale_after_ns: Annotated[Nanoseconds, Field(ge=1_000_000, le=10_000_000_000)] = 60_000_000
    fade_ns: Annotated[Nanoseconds, Field(ge=1_000_000, le=1_000_000_000)] = 40_000_000
    ramp_ns: Annotated[Nanoseconds, Field(ge=1_000_000, le=10_000_000_000)] = 300_000_000
    overforce: Annotated[float, Field(ge=1, le=10)] = 1.08
    feedback_within_ns: Annotated[Nanoseconds, Field(ge=1_000_000, le=80_000_000)] = 40_000_000

    @property
    def overforce_n(self) -> float:
        """Felt force that is a fault."""
        return self.force_limit_n * self.overforce
