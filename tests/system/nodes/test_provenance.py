"""Provenance of results, without the secrets of a scene or a command line."""

import json
import platform
import re
from pathlib import Path

import pytest

from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from protocol.provenance import REDACTED, collect
from telepulse.experiment.session import load_plan
from tests.support.nodes import RADIAL, ROOT, read_json, run


def test_provenance_names_scene_host_command_and_the_settings_in_effect() -> None:
    found = collect(RADIAL, {"display": load_section(RADIAL, "display", DisplayScene)}, {"link": 3})
    assert found.python == platform.python_version()
    assert found.seeds == {"link": 3}
    assert found.start_utc.endswith("+00:00")
    assert found.scene["path"] == str(RADIAL)
    assert "sensing" in found.scene["tables"]
    # A default that is not in the file.
    assert found.effective["display"]["safety"]["force_limit_n"] == 2.5
    table = json.loads(found.to_bytes())
    assert table == found.to_dict()
    assert table["actuator"]["kind"] == "stepper"
    assert "kp" in table["gains"]


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


def test_provenance_has_a_scenes_options_without_their_secrets(
    scene: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["display-node", "--connect", f"tcp://a:{SECRET}@host:5555"])
    found = collect(scene, {"display": load_section(scene, "display", DisplayScene)})
    assert SECRET not in found.to_bytes().decode()
    assert found.command[2] == f"tcp://{REDACTED}@host:5555"
    for drive in (found.scene["tables"]["display"]["drive"], found.effective["display"]["drive"]):
        assert drive["channel"] == f"ws://{REDACTED}@adapter.local:54701/"
        assert drive["options"] == {
            "cloud_token": REDACTED,
            "api_key": REDACTED,
            "app_name": "bench",
            "dsn": f"a=1;PWD={REDACTED}",
        }


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
