"""Scene files: all sections, and the objects built from them without hardware."""

from fuzz.refusals import check_line
from fuzz.targets import scratch_folder
from protocol.config.scene_file import find_scene, scene_names
from protocol.errors import SceneError
from telepulse.scene import load_scene

_FILE = scratch_folder() / "scene.toml"


def seeds() -> list[bytes]:
    """Return the shipped scenes."""
    return [find_scene(name).read_bytes() for name in scene_names()]


def try_one(data: bytes) -> None:
    """Load a scene, or refuse it in one line."""
    _FILE.write_bytes(data)
    try:
        load_scene(_FILE)
    except SceneError as error:
        check_line(error)
