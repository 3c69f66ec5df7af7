"""Recordings as sources: opened as a scene does, or refused."""

from pathlib import Path

import pytest

from protocol.config.scene import validate
from protocol.errors import SourceError
from sensing_node.sources.recorded import RecordedSource, RecordingScene


def table(path: Path, **keys: object) -> dict[str, object]:
    """The scene's table of a recording in N at 100 Hz, with these keys."""
    return {"kind": "recording", "path": path.name, "rate": "100 Hz", "unit": "N"} | keys


def recording(path: Path, **keys: object) -> RecordedSource:
    """The recording in a file, opened."""
    scene = validate(table(path, **keys), RecordingScene, "[sensing] source")
    return RecordedSource(scene, path.parent)


def refusal(path: Path, **keys: object) -> str:
    """The one line in which a file is refused, less its name at the beginning."""
    with pytest.raises(SourceError) as caught:
        recording(path, **keys)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text.removeprefix(f"{path}: ")
