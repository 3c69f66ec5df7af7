"""Provenance of results, without the secrets of a scene or a command line."""

import json
import re
from pathlib import Path

import pytest

from protocol.provenance import REDACTED
from telepulse.experiment.session import load_plan
from tests.support.nodes import RADIAL, ROOT, read_json, run

SECRET = "hunter2"
DRIVE = f"""
[display.drive]
kind = "tmcl"
interface = "remote"
channel = "ws://lab:{SECRET}@adapter.local:54701/"

[display.drive.options]
cloud_token = "{SECRET}"
api_key = "{SECRET}"
app_name = "bench"
dsn = "a=1;PWD={SECRET}"
"""


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return a scene whose drive is behind an adapter with credentials."""
    path = tmp_path / "scene.toml"
    path.write_text(RADIAL.read_text(encoding="utf-8") + DRIVE, encoding="utf-8")
    return path


def test_a_summary_has_its_provenance_and_neither_it_nor_an_experiments_log_has_a_secret(
    scene: Path,
) -> None:
    out, session = scene.parent / "out.json", scene.parent / "session.toml"
    command = ("simulate", str(scene), "--seconds", "1", "--seed", "7", "--json", str(out))
    result = run("telepulse", *command)
    assert result.returncode == 0
    found = read_json(out)["provenance"]
    assert found["seeds"] == {"link": 7, "source": found["effective"]["sensing"]["source"]["seed"]}
    assert found["command"][1:] == list(result.args[4:])
    assert {"version", "host", "platform", "actuator", "gains"} <= found.keys()
    example = (ROOT / "telepulse" / "experiment" / "example.toml").read_text(encoding="utf-8")
    session.write_text(re.sub("(?m)^scene = .*", f'scene = "{scene}"', example), encoding="utf-8")
    for text in (out.read_text(encoding="utf-8"), json.dumps(load_plan(session).tables)):
        assert SECRET not in text
        assert REDACTED in text
