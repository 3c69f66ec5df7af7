import json
import platform
from pathlib import Path

import pytest

from display_node.scene import DisplayScene
from protocol import provenance
from protocol.config.scene import load_section
from protocol.errors import WireError
from protocol.provenance import MAX_BYTES, collect, read_provenance
from tests.support.nodes import RADIAL, run


def test_it_names_scene_host_and_command_and_what_is_in_effect() -> None:
    found = collect(RADIAL, {"display": load_section(RADIAL, "display", DisplayScene)}, {"link": 3})
    assert found.python == platform.python_version()
    assert found.seeds == {"link": 3}
    assert found.start_utc.endswith("+00:00")
    assert found.scene["path"] == str(RADIAL)
    assert "sensing" in found.scene["tables"]
    # A default that the file does not name.
    assert found.effective["display"]["safety"]["force_limit_n"] == 2.5
    assert found.actuator["kind"] == "stepper"
    assert "kp" in found.gains
    assert json.loads(found.to_bytes()) == found.to_dict()


def test_the_commit_is_a_checkouts_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(provenance, "_ROOT", tmp_path)
    assert collect().commit is None
    assert "commit" not in collect().to_dict()
    (tmp_path / ".git").mkdir()
    assert collect().commit is None


def test_a_summary_carries_it_and_no_key(tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    result = run("telepulse", "simulate", "--seconds", "1", "--seed", "7", "--json", str(out))
    assert result.returncode == 0
    found = json.loads(out.read_text(encoding="utf-8"))["provenance"]
    assert found["seeds"] == {"link": 7, "source": found["effective"]["sensing"]["source"]["seed"]}
    assert found["command"][1:] == list(result.args[4:])
    assert {"version", "host", "platform", "actuator", "gains"} <= found.keys()


@pytest.mark.parametrize("data", [b"", b"[]", b"\xff", b"{", b'"' + b"x" * MAX_BYTES + b'"'])
def test_hostile_bytes_are_refused(data: bytes) -> None:
    with pytest.raises(WireError):
        read_provenance(data)


def test_tables_of_a_message_are_text() -> None:
    assert read_provenance(b'{"a": "b", "c": {"d": 1}}') == {"a": "b", "c": '{"d": 1}'}
