"""The tables of the actuator and of the film under the finger."""

import math
from abc import abstractmethod
from typing import Annotated, ClassVar, Literal, Protocol, Self

from pydantic import Field

from display_node.plant.contact import ContactLaw
from display_node.plant.filters import LowPass
from protocol.config.kinds import KindGroup, KindTable, load_object
from protocol.config.quantities import (
    Hertz,
    Metres,
    Nanoseconds,
    Newtons,
    NewtonsPerMetre,
    Volts,
    VoltsPerNewton,
)
from protocol.config.scene import Section
from protocol.errors import SceneError
from protocol.tactile import Adc, ElasticLayer, Film
from pulse_drives.scene import MotorScene


class ForceModel(Protocol):
    """Model of an actuator whose output, held for a tick, becomes a force.

    It is linear and pure: a copy of it predicts.

    Attributes
    ----------
    STATE
        Names of its state variables.
    force_n
        Force in N at the last tick's end.
    """

    STATE: ClassVar[tuple[str, ...]]
    force_n: float

    @property
    def response(self) -> float:
        """Force in N at a tick's end for each unit of the output held during it."""

    def drift(self) -> float:
        """Return the force's change in N in the next tick without an output."""

    def step(self, output: float) -> float:
        """Hold an output for one tick and return the force in N at its end."""

    def place(self, force_n: float) -> None:
        """Set the state to a force in N, at rest."""


class ActuatorScene(KindTable):
    """Base of the `actuator` tables.

    An actuator is either driven by speeds, a `StepperScene`, or by an output that becomes a force.
    """

    @property
    def stepper(self) -> "StepperScene | None":
        """The table where speeds drive the actuator; None where an output becomes a force."""
        return None

    @property
    def output_limit(self) -> float:
        """Largest output, of either sign."""
        return math.inf

    @abstractmethod
    def build(self, tick_s: float) -> ForceModel:
        """Build the model of an output that becomes a force."""


class SecondOrderScene(ActuatorScene):
    """The `actuator` table of kind "second_order"; defaults are the paper's Table 4.

    The paper gives m in kg, c in N·s/m and k in N/m. These cannot be the units where the output is
    a force, so they are plain numbers here. `voltage_limit` is not from the paper.
    """

    kind: Literal["second_order"]
    m: Annotated[float, Field(ge=1e-12, le=1e12)] = 0.65
    c: Annotated[float, Field(ge=0, le=1e12)] = 0.61
    k: Annotated[float, Field(ge=0, le=1e12)] = 4.23
    voltage_limit: Annotated[float, Field(gt=0)] = 1e6

    @property
    def output_limit(self) -> float:
        """See `ActuatorScene.output_limit`."""
        return self.voltage_limit

    def build(self, tick_s: float) -> ForceModel:
        """See `ActuatorScene.build`."""
        model: ForceModel = load_object("display_node.plant.second_order:SecondOrder")(self, tick_s)
        return model


class StepperScene(MotorScene, ActuatorScene):
    """The `actuator` table of kind "stepper".

    rotor_resonance, rotor_damping (ζ): without a resonance, the rotor follows the commanded
    microstep exactly. backlash: that of the screw. latency: time from a command to its motion.
    """

    kind: Literal["stepper"]
    thrust_n: Annotated[Newtons, Field(gt=0)] = 100.0
    tip_radius_m: Annotated[Metres, Field(ge=1e-6, le=1)] = 5e-3
    fingertip_n_per_m: Annotated[NewtonsPerMetre, Field(ge=1e-3, le=1e12)] = 1e3
    rotor_resonance_hz: Annotated[Hertz, Field(ge=10, le=10_000)] | None = None
    rotor_damping: Annotated[float, Field(ge=0, le=10)] = 0.2
    backlash_m: Annotated[Metres, Field(ge=0, le=1e-3)] = 0.0
    latency_ns: Annotated[Nanoseconds, Field(ge=0, le=50_000_000)] = 0

    @property
    def stepper(self) -> Self:
        """See `ActuatorScene.stepper`."""
        return self

    def build(self, tick_s: float) -> ForceModel:
        """Raise SceneError: the force of a stepper depends on its contact law."""
        raise SceneError(f"[display] actuator: speeds drive an actuator of kind {self.kind!r}")

    @property
    def steps_per_m(self) -> float:
        """Microsteps for each metre of travel, so also a step rate in Hz for each m/s."""
        return 1 / self.step_m

    def contact(self, layer: ElasticLayer) -> ContactLaw:
        """Return the contact law of this tip on the local layer; the tip itself is rigid."""
        reduced_pa = layer.young_modulus_pa / (1 - layer.poisson_ratio**2)
        return ContactLaw(self.tip_radius_m, reduced_pa, self.fingertip_n_per_m)

    def deepest_m(self, layer: ElasticLayer, force_limit_n: float) -> float:
        """Return the position at which the contact law gives the force limit or the thrust."""
        return self.contact(layer).position(min(self.thrust_n, force_limit_n))


ACTUATORS = KindGroup(
    "telepulse.actuators",
    "actuator",
    ActuatorScene,
    {
        "second_order": "display_node.plant.scene:SecondOrderScene",
        "stepper": "display_node.plant.scene:StepperScene",
    },
)


class FilmTable(Section):
    """The `film` table: the PVDF film under the finger (Table 1 of Dargahi et al. 2008: 9 mm).

    sensitivity: that of the film with its amplifier, such as 44 mV/N in Fig. 4 there; by default
    eq 21 gives it from the radius. filter: corner of the low-pass of `filter_order` poles behind
    the film. noise: RMS before the filter. adc_bits: resolution over ±adc_range. latency: age of a
    reading when it is read.
    """

    radius_m: Annotated[Metres, Field(gt=0)] = 9e-3
    sensitivity_v_per_n: Annotated[VoltsPerNewton, Field(gt=0)] | None = None
    filter_hz: Annotated[Hertz, Field(gt=0)] | None = None
    filter_order: Annotated[int, Field(ge=1, le=4)] = 1
    noise_n: Annotated[Newtons, Field(ge=0, le=10)] = 0.0
    adc_bits: Annotated[int, Field(ge=2, le=32)] | None = None
    adc_range_v: Annotated[Volts, Field(gt=0)] = 10.0
    latency_ns: Annotated[Nanoseconds, Field(ge=0, le=50_000_000)] = 0

    @property
    def volts_per_newton(self) -> float:
        """Voltage at the ADC per newton."""
        return self.sensitivity_v_per_n or Film(self.radius_m).volts_per_newton

    @property
    def millivolts_per_newton(self) -> float:
        """Scale of the paper's gains in mV/N: that of eq 21, without the amplifier."""
        return 1e3 * Film(self.radius_m).volts_per_newton

    @property
    def noise_with_adc_n(self) -> float:
        """RMS error of a reading in N: noise and the ADC's rounding."""
        if self.adc_bits is None:
            return self.noise_n
        step_n = Adc(self.adc_bits, self.adc_range_v).step_volts / self.volts_per_newton
        return math.hypot(self.noise_n, step_n / math.sqrt(12))

    def low_pass(self, tick_s: float) -> LowPass | None:
        """Return the model of the filter behind the film; None without a filter."""
        return LowPass(self.filter_hz, self.filter_order, tick_s) if self.filter_hz else None
