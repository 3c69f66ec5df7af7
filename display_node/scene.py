"""The [display] section of a scene."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from display_node.control.force_loop import HELD_S, ForceLoop, build_force_loop
from display_node.control.scene import ControllerScene, SafetyScene
from display_node.hardware import Hardware
from display_node.plant.feedback import Feedback
from display_node.plant.film_plausibility import RisingForce
from display_node.plant.scene import ACTUATORS, ActuatorScene, FilmTable
from display_node.prediction.scene import DEFAULT_PREDICTOR, PredictorTable
from display_node.prediction.trust import DelayChoice
from display_node.press.scene import PressScene
from protocol.config.kinds import OfKind
from protocol.config.quantities import Name, Nanoseconds, Ratio, parse_quantity
from protocol.config.scene import Section
from protocol.config.scene_file import merge
from protocol.errors import SceneError
from protocol.wire.description import HOLD_DOWN, LayerTable, first_repeated
from protocol.wire.messages import MAX_CHANNELS
from pulse_drives import Drive
from pulse_drives.axis import build_axis
from pulse_drives.scene import DriveTable
from pulse_sensors.drive_film import DriveFilmScene
from pulse_sensors.sensor import SENSORS, Sensor, SensorScene, one_force

MAX_COMPENSATION_NS = 10_000_000_000
MAX_CONTACTORS = 8


FilmSensor = Annotated[
    SensorScene | DriveFilmScene,
    OfKind(SENSORS, also={"drive": DriveFilmScene}),
    AfterValidator(one_force),
]


def _time_or_choice(value: object) -> int | DelayChoice:
    if value == "auto" or value == "shape":
        return value
    delay_ns = round(parse_quantity(value, "time") * 1e9)
    if not 0 <= delay_ns <= MAX_COMPENSATION_NS:
        raise ValueError(f"{value!r} is out of range: 0 s to 10 s, 'auto' or 'shape'")
    return delay_ns


def _count_of_paths(value: object) -> object:
    if value == "auto":
        raise ValueError('"auto" is not known: write paths = 3 where a link loses packets, else 1')
    return value


class ContactorScene(Section):
    """Settings that play one channel of the stream under one finger.

    name: by default the channel's. channel: name of the channel, or its number from 0. drive and
    feedback: the real bench, which replaces the models of actuator and film; without feedback, the
    force is computed from the position that the drive reports.
    """

    name: Name | None = None
    channel: Annotated[int, Field(strict=True, ge=0, lt=MAX_CHANNELS)] | Name = 0
    controller: ControllerScene
    actuator: Annotated[ActuatorScene, OfKind(ACTUATORS)]
    drive: DriveTable | None = None
    feedback: FilmSensor | None = None
    layer: LayerTable = LayerTable()
    film: FilmTable = FilmTable()

    @model_validator(mode="after")
    def _film_has_a_drive(self) -> Self:
        if self.feedback is None:
            return self
        if self.drive is None:
            raise ValueError("feedback requires a real drive: add [display.drive]")
        if isinstance(self.feedback, DriveFilmScene) and not self.drive.reads_film:
            kind = self.drive.kind
            raise ValueError(f'feedback of kind "drive": a drive of kind "{kind}" reads no film')
        return self

    @property
    def shown_name(self) -> str:
        """The contactor's name in outputs."""
        channel = self.channel
        return self.name or (channel if isinstance(channel, str) else f"channel {channel}")


class DisplayScene(ContactorScene):
    """The `display` table: settings of the display node.

    compensation: the perceived delay E as a time, or how it is chosen. "auto": the delay at which
    the felt force is nearest to the present pulse, among those at which a finger notices an error
    of the prediction for at most `noticed_target` of the time. "shape": the least delay at which
    the prediction changes no shape of the pulse. With a predictor that does not learn, both are the
    smallest delay at which at most `late_target` of the samples are late, which prediction reduces
    otherwise. predictor: name of the predictor that supplies
    missing samples. paths: number of parallel TCP connections for frames, of which the first copies
    are used. announce: whether a channel of the stream that announces the beats is used by the
    predictor.

    press: the press of the first contactor's finger, which sets the hold-down at the wrist.

    contactor: one table for each of several contactors. Each inherits the tables of `display`,
    as a scene does from the one that it extends. Without any, `display` describes the only one.
    """

    contactor: Annotated[tuple[ContactorScene, ...], Field(max_length=MAX_CONTACTORS)] = ()
    safety: SafetyScene = SafetyScene()
    press: PressScene | None = None
    compensation_ns: Annotated[int | DelayChoice, BeforeValidator(_time_or_choice)] = "auto"
    noticed_target: Annotated[Ratio, Field(gt=0, le=0.5)] = 0.02
    late_target: Annotated[Ratio, Field(gt=0, le=0.5)] = 0.01
    predictor: PredictorTable = DEFAULT_PREDICTOR
    announce: Literal["auto", "off"] = "auto"
    tick_ns: Annotated[Nanoseconds, Field(ge=100_000, le=100_000_000)] = 1_000_000
    paths: Annotated[int, Field(ge=1, le=8), BeforeValidator(_count_of_paths)] = 1

    @model_validator(mode="before")
    @classmethod
    def _contactors_inherit(cls, table: object) -> object:
        if not isinstance(table, dict) or not isinstance(own := table.get("contactor"), list):
            return table
        shared = {key: table[key] for key in ContactorScene.model_fields if key in table}
        contactors = [merge(shared, each) if isinstance(each, dict) else each for each in own]
        return {**table, "contactor": contactors}

    @model_validator(mode="after")
    def _contactors_differ(self) -> Self:
        if self.contactor and self.model_fields_set & {"name", "channel"}:
            raise ValueError("name and channel belong to each [[display.contactor]]")
        twice = first_repeated(each.shown_name for each in self.contactor)
        if twice is not None:
            raise ValueError(f"two contactors have the name {twice!r}; give each its own")
        static = HOLD_DOWN if self.press is None else self.press.channel
        if static in (self.channel, *(each.channel for each in self.contactor)):
            raise ValueError(
                f'channel "{static}" holds the probe down and is no pulse; leave out'
                " the contactor that plays it"
            )
        return self

    @model_validator(mode="after")
    def _tips_leave_in_time(self) -> Self:
        for each in self.contactors:
            stepper = each.actuator.stepper
            if each.drive is not None and stepper is not None:
                limit_n = each.safety.force_limit_n
                build_axis(each.drive, stepper, stepper.deepest_m(each.layer.layer(), limit_n))
        return self

    @property
    def contactors(self) -> tuple["DisplayScene", ...]:
        """The settings of each contactor, as those of a display that has no other one."""
        if not self.contactor:
            return (self,)
        keys = ContactorScene.model_fields
        changes = ({key: getattr(each, key) for key in keys} for each in self.contactor)
        return tuple(self.model_copy(update=each | {"contactor": ()}) for each in changes)

    def choose(self, name: str | None) -> "DisplayScene":
        """Return the settings of the contactor of a name; None: those of the only one.

        Raises SceneError where there is none of that name, or several without one.
        """
        found = {each.shown_name: each for each in self.contactors}
        if name is None and len(found) == 1:
            return self.contactors[0]
        if name is None or name not in found:
            given = "several" if name is None else f"no {name!r}"
            raise SceneError(
                f"[display] contactor: {given}: choose with --contactor one of {', '.join(found)}"
            )
        return found[name]

    def force_loop(self, actual: ActuatorScene | None = None) -> ForceLoop:
        """Build the force loop; it drives the actuator `actual`, or the scene's where None."""
        return build_force_loop(
            self.controller,
            self.actuator,
            self.layer.layer(),
            self.film,
            self.safety.force_limit_n,
            self.tick_ns * 1e-9,
            actual,
            slew_limit_n_per_s=self.safety.slew_limit_n_per_s,
            overforce=self.safety.overforce,
            held_s=HELD_S if self.drive is None else self.drive.held_ns * 1e-9,
        )

    def hardware(self, drive: Drive, sensor: Sensor | None) -> Hardware:
        """Combine the real drive and the film's sensor, if any, into a bench.

        Raises SceneError for a scene that names no drive, or whose actuator is no stepper.
        """
        stepper = self.actuator.stepper
        if self.drive is None or stepper is None:
            raise SceneError('[display] drive: it needs an actuator of kind "stepper"')
        safety, latency_ns = self.safety, self.film.latency_ns
        return Hardware(
            drive,
            sensor,
            stepper,
            self.layer.layer(),
            Feedback(latency_ns, safety.feedback_within_ns),
            RisingForce(safety.overforce_n, safety.slew_limit_n_per_s, latency_ns),
            self.tick_ns,
            self.drive.watchdog_ns,
        )
