"""Recorded sources, opened as by a scene."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from protocol.config.scene import validate
from protocol.errors import SourceError
from sensing_node.sources.recorded import RecordedSource, RecordingScene
from tests.support.refusals import refusal_of


def table(path: Path, **keys: object) -> dict[str, object]:
    """Return a scene's table of a recording in N at 100 Hz, with further keys."""
    return {"kind": "recording", "path": path.name, "rate": "100 Hz", "unit": "N"} | keys


def recording(path: Path, **keys: object) -> RecordedSource:
    """Open the recording in a file."""
    scene = validate(table(path, **keys), RecordingScene, "[sensing] source")
    return RecordedSource(scene, path.parent)


def refusal(path: Path, **keys: object) -> str:
    """Return the one line that refuses a file, without the file's name."""
    text = refusal_of(SourceError, recording, path, **keys)
    assert text.startswith(f"{path}: ")
    return text.removeprefix(f"{path}: ")


def csv_file(folder: Path, columns: Mapping[str, Any]) -> Path:
    """Write a CSV file with a header."""
    path = folder / "pulse.csv"
    rows = [list(columns), *zip(*columns.values(), strict=True)]
    text = "\n".join(",".join(map(str, row)) for row in rows) + "\n"
    path.write_text(text, encoding="utf-8")
    return path
