"""A whole scene: the sections of both nodes and of the link, for programs that run both nodes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from display_node.scene import DisplayScene
from protocol.config.scene import SectionT, load_section, validate
from protocol.config.scene_file import find_scene, load_document, merge
from protocol.provenance import Provenance, collect
from sensing_node.scene import SensingScene
from telepulse.simulation.link_scene import LinkScene, parse_link

DEFAULT_SCENE = "radial"


@dataclass(frozen=True, slots=True)
class Scene:
    """A scene's three sections; a scene without [link] has a link without delay or loss."""

    path: Path
    sensing: SensingScene
    display: DisplayScene
    link: LinkScene


def scene_provenance(scene: Scene, seeds: Mapping[str, int] | None = None) -> Provenance:
    """Collect the provenance of a run of a whole scene. Raises SceneError."""
    sections = {"sensing": scene.sensing, "display": scene.display, "link": scene.link}
    return collect(scene.path, sections, seeds)


def load_scene(
    scene: Path | str = DEFAULT_SCENE,
    display_options: Mapping[str, str | None] = {},
    *,
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
        Values of the command line's options for [display]; None leaves the scene's.
    sensing, display, link
        Changes of the sections, key by key as in a scene that extends this one. A `link` that is a
        text, such as "delay=40ms,jitter=10ms", replaces the scene's link.

    Raises
    ------
    SceneError
        If the scene or a change of it is not valid.
    """
    path = find_scene(scene) if isinstance(scene, str) else scene
    changes = {
        "sensing": sensing,
        "display": display,
        "link": {} if isinstance(link, str) else link,
    }

    def section(name: str, schema: type[SectionT]) -> SectionT:
        if not (change := changes[name]):
            return load_section(path, name, schema)
        document = merge(load_document(path), {name: dict(change)})
        return validate(document[name], schema, f"{path}, changed: [{name}]")

    if isinstance(link, str):
        link_scene = parse_link(link)
    else:
        given = link or "link" in load_document(path)
        link_scene = section("link", LinkScene) if given else LinkScene()
    display_scene = (
        section("display", DisplayScene)
        if display
        else load_section(path, "display", DisplayScene, display_options)
    )
    return Scene(path, section("sensing", SensingScene), display_scene, link_scene)
