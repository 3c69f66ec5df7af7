"""Scene files: all sections, and what is built of them without hardware."""

from fuzz.refusals import check_line
from fuzz.scratch import scratch_folder
from protocol.config.scene_file import find_scene, scene_names
from protocol.errors import SceneError
from telepulse.scene import load_scene

_FILE = scratch_folder() / "scene.toml"


def seeds() -> list[bytes]:
    """The scenes that we ship."""
    return [find_scene(name).read_bytes() for name in scene_names()]


def try_one(data: bytes) -> None:
    """A scene, or one line that says what is wrong."""
    _FILE.write_bytes(data)
    try:
        load_scene(_FILE)
    except SceneError as error:
        check_line(error)
