"""A whole scene: the sections of both nodes and of the link, for programs that run both nodes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from protocol.config.scene_file import load_document
from protocol.provenance import Provenance, collect
from sensing_node.scene import SensingScene
from telepulse.simulation.link_scene import LinkScene

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


def load_scene(path: Path, display_options: Mapping[str, str | None] = {}) -> Scene:
    """Read and validate all sections, with options for [display]. Raises SceneError."""
    link = LinkScene()
    if "link" in load_document(path):
        link = load_section(path, "link", LinkScene)
    return Scene(
        path,
        load_section(path, "sensing", SensingScene),
        load_section(path, "display", DisplayScene, display_options),
        link,
    )
