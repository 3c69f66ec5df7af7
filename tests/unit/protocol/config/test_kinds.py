from pathlib import Path
from typing import Annotated

import pytest

from protocol.config.kinds import KindGroup, KindTable, OfKind
from protocol.config.scene import Section, load_section, validate
from protocol.errors import SceneError

OWN = "protocol.config.kinds:KindTable"
MOTORS = KindGroup("telepulse.motors", "motor", KindTable, {"own": OWN})


class Axis(Section):
    """A section with a table of any kind."""

    motor: Annotated[KindTable, OfKind(MOTORS)]


LINEAR = """
from typing import Annotated, Literal
from pydantic import Field
from protocol.config.kinds import KindTable
from protocol.config.quantities import Metres

class Linear(KindTable):
    kind: Literal["linear"]
    lead_m: Annotated[Metres, Field(gt=0)]
"""
KINDS = "linear = Linear\nmissing = Missing\nown = Linear"


def install(folder: Path, name: str, code: str, version: str = "1.2", **entry_points: str) -> None:
    """Write a distribution of one module, `name`, and what pip writes of its entry points.

    entry_points: of each group, with _ in place of its dot, lines "kind = class".
    """
    (folder / f"{name}.py").write_text(code, encoding="utf-8")
    info = folder / f"{name}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n", encoding="utf-8"
    )
    lines: list[str] = []
    for group, pairs in entry_points.items():
        lines.append(f"[{group.replace('_', '.', 1)}]")
        lines += [pair.replace("= ", f"= {name}:") for pair in pairs.splitlines()]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of distributions that are installed."""
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def read(**motor: object) -> KindTable:
    return validate({"motor": motor}, Axis, "scene: [axis]").motor


def test_a_plug_ins_table_is_read_by_its_own_model(folder: Path) -> None:
    install(folder, "linears", LINEAR, telepulse_motors=KINDS)
    table = read(kind="linear", lead="2 mm")
    assert table.model_dump() == {"kind": "linear", "lead_m": 2e-3}
    # What is dumped is what the kind's own model has, not the base's fields.
    assert Axis(motor=table).model_dump() == {"motor": table.model_dump()}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('lead = "2 mm"', "motor: kind is missing; it must be given"),
        (
            'kind = "linaer"',
            "motor: unknown kind 'linaer'; known: 'own', 'linear', 'missing'; plug-ins add kinds by"
            " entry points in telepulse.motors",
        ),
        (
            'kind = "missing"',
            'motor: motor kind "missing" of linears 1.2 cannot be used: AttributeError: module'
            " 'linears' has no attribute 'Missing'",
        ),
    ],
)
def test_errors_are_one_line_with_file_and_key(folder: Path, text: str, message: str) -> None:
    install(folder, "linears", LINEAR, telepulse_motors=KINDS)
    scene = folder / "scene.toml"
    scene.write_text(f"[display]\n[display.motor]\n{text}\n", encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        load_section(scene, "display", Axis)
    assert str(caught.value) == f"{scene}: [display] {message}"


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("import a_library_that_is_missing", "ModuleNotFoundError: No module named 'a_library_th"),
        ("raise SystemExit('three\\nlines\\nof text')", "SystemExit: three lines of text"),
        # The words after it differ between Pythons.
        ("import", "SyntaxError: "),
    ],
)
def test_a_broken_plug_in_is_named_and_disturbs_no_other_kind(
    folder: Path, code: str, reason: str
) -> None:
    install(folder, "broken_one", code, "0.3", telepulse_motors="broken = Broken")
    install(folder, "linears_two", LINEAR, telepulse_motors="linear = Linear")
    assert read(kind="linear", lead="2 mm").kind == "linear"
    with pytest.raises(SceneError, match=r"of broken_one 0\.3 cannot be used") as caught:
        read(kind="broken")
    assert f"cannot be used: {reason}" in str(caught.value)
    assert "\n" not in str(caught.value)
