"""The [sensing] section of a scene, and the source and stream it describes."""

import logging
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from protocol.config.quantities import Name, Nanoseconds, count_text
from protocol.config.scene import Section
from protocol.errors import SceneError
from protocol.wire.messages import HEADER_BYTES, MAX_FRAME_BYTES
from protocol.wire.stream import LayerTable, StreamDescription
from pulse_drives import build_drive
from pulse_drives.scene import Cia402Scene, TmclScene
from pulse_sensors.force_scale import SensorTable
from pulse_sensors.sensor import SensorScene, open_sensor
from sensing_node.conditioning import Conditioned, ConditioningScene, faults_of
from sensing_node.feeds import LiveSource, SampleSource, Source
from sensing_node.press.live_probe import LiveProbe
from sensing_node.press.load_cell import JoinedSensors, SampleSensor
from sensing_node.press.scene import ProbeScene
from sensing_node.press.set_points import SetPointServer
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from sensing_node.sources.synthetic import SyntheticScene, SyntheticSource
from sensing_node.sources.wrist import ProbedTissue, Wrist, WristScene

logger = logging.getLogger(__name__)


class SensingScene(Section):
    """The `sensing` table. batch: time that one frame covers, rounded to whole samples."""

    source: Annotated[
        SyntheticScene | RecordingScene | WristScene | SensorScene,
        Field(discriminator="kind"),
    ]
    stream: Name = "pulse"
    batch_ns: Annotated[Nanoseconds, Field(ge=100_000, le=1_000_000_000)] = 5_000_000
    samples: Literal["float32", "float64"] = "float32"
    layer: LayerTable = LayerTable()
    conditioning: ConditioningScene | None = None
    press: ProbeScene | None = None

    @model_validator(mode="after")
    def _presses_a_wrist(self) -> "SensingScene":
        is_wrist = isinstance(self.source, WristScene)
        if is_wrist and self.press is None:
            raise ValueError('a source of kind "wrist" is pressed by a probe: add [sensing.press]')
        if self.press is not None:
            drive, live = self.press.drive, isinstance(self.source, SensorTable)
            if is_wrist and (drive is not None or self.press.sensor is not None):
                raise ValueError('press: a source of kind "wrist" models drive and load cell')
            if not is_wrist and (drive is None or not live):
                raise ValueError(
                    'press needs a source of kind "wrist", or a live sensor and a table'
                    " [sensing.press.drive]"
                )
        if is_wrist and self.conditioning is not None:
            raise ValueError("conditioning has no load cell's channel; leave it out for a wrist")
        return self

    @model_validator(mode="after")
    def _conditions_what_is_simulated(self) -> "SensingScene":
        if self.conditioning is not None and isinstance(self.source, SensorTable):
            raise ValueError(
                "conditioning simulates electronics, and a live sensor has its own; leave it out"
            )
        return self


@contextmanager
def open_source(scene: SensingScene, folder: Path) -> Iterator[Source]:
    """Open the source that the scene names; a live sensor is read until the `with` ends.

    folder: folder of the scene's file. Raises SourceError or SceneError.
    """
    if isinstance(scene.source, SensorTable):
        if scene.press is not None and scene.press.drive is not None:
            with _start_probe(scene.source, scene.press, scene.press.drive, folder) as probe:
                yield LiveSource(probe, probe)
            return
        with closing(open_sensor(scene.source, folder)) as sensor:
            yield LiveSource(sensor)
        return
    source = build_source(scene, folder)
    for warning in faults_of(source):
        logger.warning(warning)
    yield source


@contextmanager
def _start_probe(
    source: SensorScene, press: ProbeScene, table: TmclScene | Cia402Scene, folder: Path
) -> Iterator[LiveProbe]:
    """Start a probe on a real drive within a `with`, which ends with its withdrawal.

    Raises SceneError, SourceError or DriveError.
    """
    drive = build_drive(table, press.motor, press.travel_m)
    with ExitStack() as unless_joined:
        film = open_sensor(source, folder)
        sensor: SampleSensor = film
        unless_joined.callback(film.close)
        if press.sensor is not None:
            cell = open_sensor(press.sensor, folder)
            unless_joined.callback(cell.close)
            sensor = JoinedSensors(film, cell)
        probe = LiveProbe(press.limits(), drive, sensor)
        unless_joined.pop_all()
    with closing(probe):
        probe.start()
        yield probe


def build_source(scene: SensingScene, folder: Path, plausible: bool = True) -> SampleSource:
    """Build the source that the scene names, behind its conditioning chain if it has one.

    folder: folder of the scene's file. plausible: refuse a recording that cannot be a pulse. Raises
    SourceError or SceneError, the latter also for a live sensor, which `open_source` opens.
    """
    source: SampleSource
    if isinstance(scene.source, SyntheticScene):
        source = SyntheticSource(scene.source)
    elif isinstance(scene.source, WristScene):
        source = Wrist(scene.source, None if scene.press is None else scene.press.limits())
    elif isinstance(scene.source, RecordingScene):
        source = RecordedSource(scene.source, folder, plausible)
    else:
        raise SceneError(
            f'[sensing] source: kind "{scene.source.kind}" is a live sensor; a sensing node reads'
            " it, nothing else can"
        )
    return source if scene.conditioning is None else Conditioned(source, scene.conditioning)


def serve_set_points(source: object, session: int) -> SetPointServer | None:
    """Return a server of the set-points for the probe of a source; None without a probe."""
    probe = source.probe if isinstance(source, LiveSource) else source
    return SetPointServer(session, probe) if isinstance(probe, ProbedTissue | LiveProbe) else None


def describe_stream(scene: SensingScene, source: Source) -> StreamDescription:
    """Return the description that is sent to the displays. Raises SceneError."""
    batch = max(1, round(scene.batch_ns / source.period_ns))
    if batch > 4096:
        raise SceneError(f"[sensing] batch: {batch} samples a frame; at most 4096 fit")
    width: Literal[4, 8] = 8 if scene.samples == "float64" else 4
    most = (MAX_FRAME_BYTES - HEADER_BYTES) // (len(source.channels) * width)
    if batch > most:
        raise SceneError(
            f"[sensing] batch: {batch} samples of {count_text(len(source.channels), 'channel')} are"
            f" more than a frame takes; at most {most} fit"
        )
    return StreamDescription(
        name=scene.stream,
        period_ns=source.period_ns,
        batch=batch,
        channels=source.channels,
        layer=scene.layer.layer(),
        bytes_per_sample=width,
        group_delay_ns=source.group_delay_ns if isinstance(source, Conditioned) else 0,
    )
