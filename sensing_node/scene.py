"""The [sensing] section of a scene, and the source and stream it describes."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from protocol.errors import SceneError
from protocol.quantities import Nanoseconds
from protocol.scene import Section
from protocol.stream import LayerTable, Name, StreamDescription
from sensing_node.conditioning import Conditioned, ConditioningScene
from sensing_node.sources import Samples
from sensing_node.sources.recording import Recording, RecordingScene
from sensing_node.sources.synthetic import Synthetic, SyntheticScene

_WIDTHS: dict[str, Literal[4, 8]] = {"float32": 4, "float64": 8}


class SensingScene(Section):
    """What the sensing node does. `batch`: how much time one frame covers, rounded to samples."""

    source: Annotated[SyntheticScene | RecordingScene, Field(discriminator="kind")]
    stream: Name = "pulse"
    batch_ns: Annotated[Nanoseconds, Field(ge=100_000, le=1_000_000_000)] = 5_000_000
    samples: Literal["float32", "float64"] = "float32"
    layer: LayerTable = LayerTable()
    conditioning: ConditioningScene | None = None


def build_source(scene: SensingScene, folder: Path) -> Samples:
    """The source the scene names, heard through its conditioning chain if it has one.

    `folder` is the scene file's. Raises SourceError or SceneError.
    """
    source: Samples
    if isinstance(scene.source, SyntheticScene):
        source = Synthetic(scene.source)
    else:
        source = Recording(scene.source, folder)
    return source if scene.conditioning is None else Conditioned(source, scene.conditioning)


def describe_stream(scene: SensingScene, samples: Samples) -> StreamDescription:
    """The description that travels to the displays. Raises SceneError."""
    batch = max(1, round(scene.batch_ns / samples.period_ns))
    if batch > 4096:
        raise SceneError(f"[sensing] batch: {batch} samples a frame; at most 4096 fit")
    return StreamDescription(
        name=scene.stream,
        period_ns=samples.period_ns,
        batch=batch,
        channels=samples.channels,
        layer=scene.layer.layer(),
        bytes_per_sample=_WIDTHS[scene.samples],
        group_delay_ns=samples.group_delay_ns if isinstance(samples, Conditioned) else 0,
    )
