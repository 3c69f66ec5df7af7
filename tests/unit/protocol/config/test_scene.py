from pathlib import Path
from typing import Annotated, Literal

import pytest
from pydantic import Field

from protocol.config.kinds import OfKind
from protocol.config.quantities import Metres, Nanoseconds, Newtons, Ratio
from protocol.config.scene import Section, load_section, validate
from protocol.config.scene_file import load_document
from protocol.errors import SceneError
from tests.support.refusals import refusal_of


class Motor(Section):
    kind: Literal["motor"]
    lead_m: Annotated[Metres, Field(gt=0)]


class Spring(Section):
    kind: Literal["spring"]
    gain: float = 1.0


class Table(Section):
    actuator: Annotated[Motor | Spring, OfKind(also={"motor": Motor, "spring": Spring})] = Spring(
        kind="spring"
    )
    tick_ns: Annotated[Nanoseconds, Field(ge=100_000, le=100_000_000)] = 1_000_000
    limit_n: Newtons | None = None
    force_n: Literal["auto"] | Newtons = "auto"
    share: Annotated[Ratio, Field(gt=0, le=0.5)] = 0.1
    channel: Annotated[int, Field(ge=0, le=63)] = 0
    mode: Literal["hold", "linear"] = "hold"
    name: Annotated[str, Field(min_length=1)] = "x"
    springs: tuple[Spring, ...] = ()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "a scene.toml"


def load(path: Path, text: str) -> Table:
    path.write_text(text, encoding="utf-8")
    return load_section(path, "display", Table)


def line_of(path: Path, text: str) -> str:
    """The error's line, without the file's name that it begins with."""
    line = refusal_of(SceneError, load, path, text)
    assert line.startswith(f"{path}: ")
    return line.removeprefix(f"{path}: ")


def test_a_scene_is_read_into_si_units(path: Path) -> None:
    table = load(
        path,
        """
        title = "of no matter to a node"
        [sensing]
        anything = "goes here, for this node"
        [display]
        tick = "2 ms"
        limit = "300 mN"
        force = "0.5 N"
        share = "5 %"
        [display.actuator]
        kind = "motor"
        lead = "2 mm"
        [[display.springs]]
        kind = "spring"
        """,
    )
    assert table.actuator == Motor.model_validate({"kind": "motor", "lead": "2 mm"})
    assert (table.tick_ns, table.limit_n, table.force_n) == (2_000_000, 0.3, 0.5)
    assert table.share == pytest.approx(0.05)
    assert table.mode == "hold"
    assert table.springs == (Spring(kind="spring"),)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("chanel = 1", "chanel: unknown key; did you mean channel?"),
        ("tick_ns = 5", "tick_ns: unknown key; did you mean tick?"),
        ('tick = "1 us"', "tick: must be greater than or equal to 100 us, got '1 us'"),
        ('tick = "3 s"', "tick: must be less than or equal to 0.1 s, got '3 s'"),
        ('force = "x"', "force: must be 'auto', got 'x' (and 1 more)"),
        ('channel = "a"', "channel: must be a valid integer"),
        ('mode = "lin"', "mode: must be 'hold' or 'linear', got 'lin'"),
        ('mode = "a\\nb"', "mode: must be 'hold' or 'linear', got 'a\\nb'"),
        ('actuator = "motor"', "actuator: must be a table, got 'motor'"),
        ("springs = 5", "springs: must be a valid tuple, got 5"),
    ],
)
def test_a_wrong_key_or_value_is_named(path: Path, text: str, line: str) -> None:
    assert line_of(path, f"[display]\n{text}").startswith(f"[display] {line}")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('kind = "moter"', "actuator: unknown kind 'moter'; known: 'motor', 'spring'"),
        ('lead = "1 mm"', "actuator: kind is missing; it must be given"),
        ('kind = "motor"', "actuator.lead: missing; it must be given"),
        ('kind = "motor"\nlead = "-2 mm"', "actuator.lead: must be greater than 0 mm, got '-2 mm'"),
        ('kind = "spring"\ngian = 1', "actuator.gian: unknown key; did you mean gain?"),
        ('kind = "spring"\ngain = inf', "actuator.gain: must be a finite number, got inf"),
        ('kind = "spring"\ngain = nan', "actuator.gain: must be a finite number, got nan"),
    ],
)
def test_a_key_of_an_inner_table_is_named_as_in_the_file(path: Path, text: str, line: str) -> None:
    assert line_of(path, f"[display.actuator]\n{text}").startswith(f"[display] {line}")


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("display = 3", "[display] must be a table, got "),
        ("", "section [display] is missing"),
        ("[displya]", "displya: unknown key; did you mean display?"),
        ('"a\\nb" = 1', '"a\\nb": unknown key; known: sensing, display, link'),
        ("[display]\n[foo]", "foo: unknown key"),
    ],
)
def test_a_wrong_or_missing_section_is_named(path: Path, text: str, line: str) -> None:
    assert line_of(path, text).startswith(line)


@pytest.mark.parametrize(
    "text",
    [
        "[display", "tick 5", "[display]\ntick = \n", "[display]\n[display]", "x = " + "1" * 5000,
        "x = " + "[" * 5000,
    ],
    ids=["bracket", "equals", "value", "twice", "digits", "nesting"],
)  # fmt: skip
def test_a_file_that_is_not_toml(path: Path, text: str) -> None:
    assert line_of(path, text).startswith("not TOML: ")
    assert "line 2" in line_of(path, "[display]\ntick 5")


def test_a_file_that_cannot_be_read_is_refused_in_one_line(path: Path, tmp_path: Path) -> None:
    def refusal(path: Path) -> str:
        return refusal_of(SceneError, load_document, path)

    assert refusal(path) == f"{path}: no such scene file"
    assert refusal(tmp_path).startswith(f"{tmp_path}: cannot be read: ")
    assert "directory" in refusal(tmp_path)
    for data in (b"\xff\xfe[\x00", b'title = "caf\xe9"'):
        path.write_bytes(data)
        assert refusal(path).startswith(f"{path}: cannot be read: 'utf-8' codec")
    assert "cannot be read" in refusal(path / "inner.toml")


def test_a_table_from_elsewhere_is_named_by_its_origin() -> None:
    with pytest.raises(SceneError, match=r"^--link 'x': mod: unknown key; did you mean mode\?$"):
        validate({"mod": "hold"}, Table, where="--link 'x':")
