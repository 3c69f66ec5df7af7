"""The [display] section of a scene."""

from typing import Annotated

from pydantic import BeforeValidator, Field, model_validator

from display_node.control.force_loop import ForceLoop, build_force_loop
from display_node.control.scene import ControllerScene, SafetyScene
from display_node.drives import Drive
from display_node.drives.hardware import Hardware
from display_node.drives.scene import DriveTable
from display_node.plant.feedback import Feedback, RisingForce
from display_node.plant.scene import FilmTable, SecondOrderScene, StepperScene
from display_node.prediction import PredictorName
from protocol.config.quantities import Nanoseconds, Ratio, parse_quantity
from protocol.config.scene import Section
from protocol.errors import SceneError
from protocol.wire.stream import LayerTable
from pulse_sensors.sensor import Sensor, SensorScene

MAX_COMPENSATION_NS = 10_000_000_000


def _time_or_auto(value: object) -> int | None:
    if value == "auto":
        return None
    delay_ns = round(parse_quantity(value, "time") * 1e9)
    if not 0 <= delay_ns <= MAX_COMPENSATION_NS:
        raise ValueError(f"{value!r} is out of range: 0 s to 10 s, or 'auto'")
    return delay_ns


def _count_or_auto(value: object) -> object:
    return None if value == "auto" else value


class DisplayScene(Section):
    """The `display` table: settings of the display node.

    compensation: the perceived delay E as a time, or "auto" (stored as None) for the smallest
    delay at which at most `late_target` of the samples are late; with a predictor that learns, E is
    reduced while the predictor's error is small. predictor: name of the predictor that supplies
    missing samples. channel: channel of the stream that is felt. paths: number of parallel TCP
    connections for frames, of which the first copies are used, or "auto" (stored as None): one, and
    further ones while TCP stalls.

    drive and feedback: the real bench, which replaces the models of actuator and film; without
    feedback, the force is computed from the position that the drive reports.
    """

    controller: ControllerScene
    actuator: Annotated[SecondOrderScene | StepperScene, Field(discriminator="kind")]
    drive: DriveTable | None = None
    feedback: Annotated[SensorScene | None, Field(discriminator="kind")] = None
    layer: LayerTable = LayerTable()
    film: FilmTable = FilmTable()
    safety: SafetyScene = SafetyScene()
    compensation_ns: Annotated[int | None, BeforeValidator(_time_or_auto)] = None
    late_target: Annotated[Ratio, Field(gt=0, le=0.5)] = 0.01
    predictor: PredictorName = "stack"
    tick_ns: Annotated[Nanoseconds, Field(ge=100_000, le=100_000_000)] = 1_000_000
    channel: Annotated[int, Field(ge=0, le=63)] = 0
    paths: Annotated[Annotated[int, Field(ge=1, le=8)] | None, BeforeValidator(_count_or_auto)] = (
        None
    )

    @model_validator(mode="after")
    def _film_has_a_drive(self) -> "DisplayScene":
        if self.feedback is not None and self.drive is None:
            raise ValueError("feedback requires a real drive: add [display.drive]")
        return self

    def force_loop(self, actual: SecondOrderScene | StepperScene | None = None) -> ForceLoop:
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
        )

    def hardware(self, drive: Drive, sensor: Sensor | None) -> Hardware:
        """Combine the real drive and the film's sensor, if any, into a bench.

        Raises SceneError for a scene that names no drive, or whose actuator is no stepper.
        """
        if self.drive is None or not isinstance(self.actuator, StepperScene):
            raise SceneError('[display] drive: it needs an actuator of kind "stepper"')
        safety, latency_ns = self.safety, self.film.latency_ns
        overforce_n = safety.force_limit_n * safety.overforce
        return Hardware(
            drive,
            sensor,
            self.actuator,
            self.layer.layer(),
            Feedback(latency_ns, safety.feedback_within_ns),
            RisingForce(overforce_n, safety.slew_limit_n_per_s, latency_ns),
            self.tick_ns,
            self.drive.watchdog_ns,
        )
