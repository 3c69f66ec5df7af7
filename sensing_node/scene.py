"""The [sensing] section of a scene, and the source and stream it describes."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from protocol.config.kinds import OfKind
from protocol.config.quantities import MAX_NAME, Name, Nanoseconds, count_text
from protocol.config.scene import Section, load_section, validate
from protocol.config.scene_file import load_document, merge
from protocol.errors import SceneError
from protocol.wire.description import LayerTable, StreamDescription
from protocol.wire.messages import HEADER_BYTES, MAX_FRAME_BYTES
from pulse_drives import build_drive
from pulse_drives.scene import DriveScene
from pulse_sensors.sensor import SENSORS, SensorScene, open_sensor
from sensing_node.conditioning import Conditioned, ConditioningScene
from sensing_node.feeds import LiveFeed, SourceOrFeed
from sensing_node.files.signal_choice import duration_text, record_table
from sensing_node.press.live_probe import JoinedSensors, LiveProbe, SampleSensor
from sensing_node.press.scene import ProbeScene
from sensing_node.press.set_points import SetPointServer
from sensing_node.sources.source import SOURCES, SampleSource, SourceContext, SourceScene

logger = logging.getLogger(__name__)


class SensingScene(Section):
    """The `sensing` table. batch: time that one frame covers, rounded to whole samples."""

    source: Annotated[SourceScene | SensorScene, OfKind(SOURCES, SENSORS)]
    stream: Name = "pulse"
    batch_ns: Annotated[Nanoseconds, Field(ge=100_000, le=1_000_000_000)] = 5_000_000
    samples: Literal["float32", "float64"] = "float32"
    layer: LayerTable = LayerTable()
    conditioning: ConditioningScene | None = None
    press: ProbeScene | None = None

    @model_validator(mode="after")
    def _presses_a_wrist(self) -> "SensingScene":
        kind, pressable = self.source.kind, self.sensor is None and self.modelled.pressable
        if pressable and self.press is None:
            raise ValueError(
                f'a source of kind "{kind}" is pressed by a probe: add [sensing.press]'
            )
        if self.press is not None:
            drive = self.press.drive
            if pressable and (drive is not None or self.press.sensor is not None):
                raise ValueError(f'press: a source of kind "{kind}" models drive and load cell')
            if not pressable and (drive is None or self.sensor is None):
                raise ValueError(
                    'press needs a source of kind "wrist", or a live sensor and a table'
                    " [sensing.press.drive]; a recorded sweep is pressed with telepulse replay"
                    " --press"
                )
        if pressable and self.conditioning is not None:
            raise ValueError(f"conditioning has no load cell's channel; leave it out for a {kind}")
        return self

    @model_validator(mode="after")
    def _conditions_what_is_simulated(self) -> "SensingScene":
        if self.conditioning is not None and self.sensor is not None:
            raise ValueError(
                "conditioning simulates electronics, and a live sensor has its own; leave it out"
            )
        return self

    @property
    def sensor(self) -> SensorScene | None:
        """The table of a live sensor; None for a source whose samples are known in advance."""
        return self.source if isinstance(self.source, SensorScene) else None

    @property
    def modelled(self) -> SourceScene:
        """The table of a source whose samples are known in advance.

        Raises SceneError for a live sensor, which `open_source` opens.
        """
        if isinstance(self.source, SensorScene):
            raise SceneError(
                f'[sensing] source: kind "{self.source.kind}" is a live sensor; a sensing node'
                " reads it, nothing else can"
            )
        return self.source

    def still(self) -> "SensingScene | None":
        """Return the section without its pulse, as of a sensor that nothing presses.

        None where the source has a pulse always, such as a recording. Raises SceneError as
        `modelled` does.
        """
        silent = self.modelled.still()
        if silent is None:
            return None
        changes: dict[str, object] = {"source": silent}
        if self.conditioning is not None:
            changes["conditioning"] = self.conditioning.model_copy(update={"hold_down_n": 0.0})
        return self.model_copy(update=changes)


def load_sensing(
    path: Path, options: Mapping[str, str | None] = {}, changes: Mapping[str, Any] = {}
) -> SensingScene:
    """Read the [sensing] section of a scene, with a record in place of its source if one is given.

    Logs the signal that is chosen from the record.

    Parameters
    ----------
    options : mapping of str to str or None
        "source": path of the record. "channel": name or number of its signal to play; without it,
        one is chosen. "rate", "preload": further keys of the source's table, with their units.
    changes : mapping of str
        Further changes of the section that plays the record, key by key.

    Raises
    ------
    SceneError
        If the scene or an option cannot be used.
    SourceError
        If the record cannot be read.
    """
    given = {key: text for key, text in options.items() if text is not None}
    if "source" not in given:
        for key in given:
            raise SceneError(f"--{key} is of a record; give the record by --source")
        return load_section(path, "sensing", SensingScene)
    record = Path(given.pop("source"))
    source, chosen = record_table(record, given.pop("channel", None), given.get("rate"))
    source |= given
    logger.info(chosen)
    sensing = {**load_document(path).get("sensing", {}), "source": source}
    if record.stem.isprintable():
        sensing["stream"] = record.stem[:MAX_NAME]
    where = f"{path}, with {record} as its source: [sensing]"
    return validate(merge(sensing, dict(changes)), SensingScene, where)


@contextmanager
def open_source(scene: SensingScene, folder: Path) -> Iterator[SourceOrFeed]:
    """Open the source that the scene names; a live sensor is read until the `with` ends.

    folder: folder of the scene's file. Raises SourceError or SceneError.
    """
    if (table := scene.sensor) is not None:
        if scene.press is not None and scene.press.drive is not None:
            with _start_probe(table, scene.press, scene.press.drive, folder) as probe:
                yield LiveFeed(probe, probe)
            return
        with closing(open_sensor(table, folder)) as sensor:
            yield LiveFeed(sensor)
        return
    source = build_source(scene, folder)
    for warning in source.notes():
        logger.warning(warning)
    yield source


def log_repetition(source: SourceOrFeed, seconds: float | None) -> None:
    """Log that a recording is shorter than the run, and how often it is played.

    seconds: length of the run; None for a run without an end. Silent where nothing is repeated.
    """
    pass_s = source.repeats_after_s if isinstance(source, SampleSource) else None
    if pass_s is None or (seconds is not None and seconds <= pass_s):
        return
    text = f"the recording lasts {duration_text(pass_s)}"
    if seconds is None:
        logger.info(f"{text}, and is played again and again")
    else:
        times = f"{seconds / pass_s:.3g} times"
        logger.info(f"{text}, and the run {duration_text(seconds)}: it is played {times}")


@contextmanager
def _start_probe(
    source: SensorScene, press: ProbeScene, table: DriveScene, folder: Path
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
        probe = LiveProbe(press, drive, sensor)
        unless_joined.pop_all()
    with closing(probe):
        probe.start()
        yield probe


def build_source(scene: SensingScene, folder: Path, plausible: bool = True) -> SampleSource:
    """Build the source that the scene names, behind its conditioning chain if it has one.

    folder: folder of the scene's file. plausible: refuse a recording that cannot be a pulse. Raises
    SourceError or SceneError, the latter also for a live sensor, which `open_source` opens.
    """
    source = scene.modelled.build(SourceContext(folder, plausible, scene.press))
    return source if scene.conditioning is None else Conditioned(source, scene.conditioning)


def serve_set_points(source: SourceOrFeed, session: int) -> SetPointServer | None:
    """Return a server of the set-points for the probe of a source; None without a probe."""
    probe = source.pressed
    return None if probe is None else SetPointServer(session, probe)


def describe_stream(scene: SensingScene, source: SourceOrFeed) -> StreamDescription:
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
        group_delay_ns=source.group_delay_ns,
    )
