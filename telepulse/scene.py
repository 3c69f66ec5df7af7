"""A whole scene: the sections of both nodes and of the link, for programs that run both nodes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from display_node.scene import DisplayScene
from protocol.config.arguments import file_path, table
from protocol.config.quantities import shown
from protocol.config.scene import SectionT, load_section, validate
from protocol.config.scene_file import find_scene, load_document, merge
from protocol.errors import ArgumentError
from protocol.provenance import Provenance, collect
from sensing_node.scene import SensingScene, load_sensing
from telepulse.simulation.link_scene import LinkScene, parse_link

DEFAULT_SCENE = "radial"
# Keys of a scene whose values are files.
FILE_KEYS = ("path", "database")
EXAMPLES = {
    "sensing": '{"source": {"heart_rate": "90 /min"}}',
    "display": '{"predictor": "linear"}',
    "link": '{"delay": "40 ms"}, or a text such as "delay=40ms"',
}


@dataclass(frozen=True, slots=True, repr=False)
class Scene:
    """A scene's three sections; a scene without [link] has a link without delay or loss.

    Attributes
    ----------
    path : Path
        File of the scene.
    sensing : SensingScene
        What the sensing node does, with values in SI units: `scene.sensing.batch_ns`.
    display : DisplayScene
        What the display does: `scene.display.compensation_ns`.
    link : LinkScene
        Impairments of the link between them: `scene.link.delay_ns`.
    """

    path: Path
    sensing: SensingScene
    display: DisplayScene
    link: LinkScene

    def __repr__(self) -> str:
        """Return the path, and the link's impairments."""
        plain = LinkScene().text().split(",")
        link = ",".join(each for each in self.link.text().split(",") if each not in plain)
        return f"Scene({str(self.path)!r}, link={link!r})"


def scene_provenance(scene: Scene, seeds: Mapping[str, int] | None = None) -> Provenance:
    """Collect the provenance of a run of a whole scene. Raises SceneError."""
    sections = {"sensing": scene.sensing, "display": scene.display, "link": scene.link}
    return collect(scene.path, sections, seeds)


def load_scene(
    scene: Path | str = DEFAULT_SCENE,
    display_options: Mapping[str, str | None] = {},
    *,
    source: Path | str | None = None,
    channel: str | int | None = None,
    rate: str | None = None,
    preload: str | None = None,
    sensing: Mapping[str, Any] = {},
    display: Mapping[str, Any] = {},
    link: Mapping[str, Any] | str = {},
) -> Scene:
    """Read and validate all sections of a scene.

    Parameters
    ----------
    scene
        File, or name of a scene that comes with telepulse.
    display_options
        Values of the command line's options for [display], which replace those of the scene and of
        `display`; None leaves those.
    source
        Recorded pulse to play in place of the scene's source: a file in any known format.
    channel, rate, preload
        Of the source: name or number of the signal to play, by default the one with the shape of a
        pulse; rate that overrides the file's, such as "500 Hz"; force to add, such as "0.3 N".
    sensing, display, link
        Changes of the sections, key by key as in a scene that extends this one. A `link` that is a
        text, such as "delay=40ms,jitter=10ms", replaces the scene's link. Files in a change are
        relative to the working directory; those in a scene's file are relative to its folder.

    Raises
    ------
    ArgumentError
        If an argument is of another type.
    SceneError
        If the scene or a change of it is not valid.
    SourceError
        If `source` cannot be read, or leaves open which of its signals is the pulse.
    """
    if not isinstance(scene, str | Path):
        raise ArgumentError(f"scene: must be a name or the path of a file, got {shown(scene)}")
    path = find_scene(scene) if isinstance(scene, str) else scene
    given = {"sensing": sensing, "display": display, "link": {} if isinstance(link, str) else link}
    changes = {name: _from_here(table(name, given[name], EXAMPLES[name])) for name in given}

    def section(name: str, schema: type[SectionT]) -> SectionT:
        if not (change := changes[name]):
            return load_section(path, name, schema)
        document = merge(load_document(path), {name: change})
        return validate(document[name], schema, f"{path}, changed: [{name}]")

    if isinstance(link, str):
        link_scene = parse_link(link)
    else:
        described = link or "link" in load_document(path)
        link_scene = section("link", LinkScene) if described else LinkScene()
    if display:
        given_options = {key: each for key, each in display_options.items() if each is not None}
        changes["display"] |= given_options
        display_scene = section("display", DisplayScene)
    else:
        display_scene = load_section(path, "display", DisplayScene, display_options)
    record = {
        "source": None if source is None else str(file_path("source", source)),
        "channel": None if channel is None else str(channel),
        "rate": rate,
        "preload": preload,
    }
    if any(option is not None for option in record.values()):
        sensing_scene = load_sensing(path, record, changes["sensing"])
    else:
        sensing_scene = section("sensing", SensingScene)
    return Scene(path, sensing_scene, display_scene, link_scene)


def _from_here(change: Mapping[str, Any]) -> dict[str, Any]:
    """Return a change whose files are relative to the working directory as absolute paths."""
    absolute = dict(change)
    for key, value in change.items():
        if isinstance(value, Mapping):
            absolute[key] = _from_here(value)
        elif key in FILE_KEYS and isinstance(value, str | Path):
            absolute[key] = str(Path(value).absolute())
    return absolute
