"""A whole scene: what each node reads, composed for runs of both."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from display_node.scene import DisplayScene
from protocol.config.scene import load_document, load_section
from protocol.errors import SceneError
from protocol.provenance import Provenance, collect
from sensing_node.scene import SensingScene
from telepulse.simulation.link_model import LinkScene

_HERE = Path(__file__).parent
SCENE_FOLDERS = (_HERE / "scenes", _HERE.parent / "scenes")
DEFAULT_SCENE = "radial"


@dataclass(frozen=True, slots=True)
class Scene:
    """A scene file's three sections; a scene without [link] has a link that costs nothing."""

    path: Path
    sensing: SensingScene
    display: DisplayScene
    link: LinkScene


def scene_provenance(scene: Scene, seeds: Mapping[str, int] | None = None) -> Provenance:
    """Collect the provenance of a run of a whole scene. Raises SceneError."""
    sections = {"sensing": scene.sensing, "display": scene.display, "link": scene.link}
    return collect(scene.path, sections, seeds)


def find_scene(name: str) -> Path:
    """A scene file by its path, or by its name among those that come with telepulse."""
    path = Path(name)
    if path.suffix == ".toml" or path.name != name:
        return path
    for folder in SCENE_FOLDERS:
        candidate = folder / f"{name}.toml"
        if candidate.exists():
            return candidate
    known = sorted({p.stem for folder in SCENE_FOLDERS for p in folder.glob("*.toml")})
    raise SceneError(f"{name}: no such scene; known by name: {', '.join(known)}")


def load_scene(path: Path) -> Scene:
    """Read and validate all sections. Raises SceneError."""
    link = LinkScene()
    if "link" in load_document(path):
        link = load_section(path, "link", LinkScene)
    return Scene(
        path,
        load_section(path, "sensing", SensingScene),
        load_section(path, "display", DisplayScene),
        link,
    )
