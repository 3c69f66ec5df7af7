from pathlib import Path

import pytest
from typer.testing import CliRunner

from protocol.security.allow_list import read_allow_list
from telepulse.cli.main import app


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def keys(*arguments: str, status: int = 0) -> str:
    """Return the output of `telepulse keys ...`, that on stderr where it fails."""
    result = CliRunner().invoke(app, ["keys", *arguments])
    assert result.exit_code == status, result.output
    assert (result.stdout if status else result.stderr) == ""
    return result.stderr if status else result.stdout


def test_a_node_gets_keys_is_allowed_listed_and_revoked() -> None:
    printed = keys("new", "finger")
    for word in ("keys/finger.key", "--key", "finger.pub", "keys allow", "--peer"):
        assert word in printed
    assert keys("allow", "keys/finger.pub") == "keys/allowed allows finger\n"
    public = Path("keys/finger.pub").read_text(encoding="utf-8").split()[2]
    assert keys("list") == f"{public}  finger\n"
    assert [peer.name for peer in read_allow_list(Path("keys/allowed")).values()] == ["finger"]
    assert keys("revoke", "finger") == "keys/allowed no longer allows finger\n"
    assert keys("list") == "keys/allowed allows nobody\n"


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("new", "finger"), "keys/finger.key: exists already; name another file"),
        (("new", "../finger"), "'../finger': not a name"),
        (("allow", "keys/finger.key"), "is a secret key, which never leaves its machine"),
        (("allow", "keys/none.pub"), "keys/none.pub: there is no such file"),
        (("revoke", "thumb"), "keys/allowed does not allow thumb; it allows nobody"),
    ],
)
def test_a_refusal_is_one_line_and_changes_no_file(arguments: tuple[str, ...], reason: str) -> None:
    keys("new", "finger")
    before = {path: path.read_bytes() for path in Path("keys").iterdir()}
    line = keys(*arguments, status=2)
    assert line.startswith("telepulse: ")
    assert reason in line
    assert line.count("\n") == 1
    assert {path: path.read_bytes() for path in Path("keys").iterdir()} == before
