"""Scenes with anything anywhere: one line that says what is wrong, or nodes that can be built."""

import copy
import datetime
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from display_node.display import Display
from display_node.scene import DisplayScene
from fuzz.refusals import check_line
from protocol.config.quantities import UNITS
from protocol.config.scene import validate
from protocol.config.scene_file import load_document
from protocol.errors import SceneError, SourceError
from sensing_node.scene import SensingScene, build_source, describe_stream
from telepulse.simulation.link_scene import LinkScene, parse_link
from tests.support.nodes import RADIAL, ROOT

SCHEMAS: dict[str, Any] = {"sensing": SensingScene, "display": DisplayScene, "link": LinkScene}
SHIPPED = [load_document(path) for path in (ROOT / "scenes").glob("*.toml")]


def keys(schema: type[BaseModel]) -> Iterator[str]:
    """Yield every key of a scene's section, those of its tables included."""
    for name, field in schema.model_fields.items():
        yield field.alias or name
        for inner in tables(field.annotation):
            yield from keys(inner)


def tables(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from tables(part)


KEYS = sorted({key for schema in SCHEMAS.values() for key in keys(schema)})

units = st.sampled_from(["", "%", *(unit for units in UNITS.values() for unit in units)])
written = st.one_of(
    st.sampled_from([True, 0, 1, -1, 2**63 - 1, 0.0, 1e308, 5e-324, "", "auto", "x\n", [], {}]),
    st.sampled_from([float("nan"), float("inf"), datetime.date(2008, 1, 1), [{"kind": "x"}]]),
    st.builds("{}e{} {}".format, st.sampled_from([-1, 0, 0.5, 1, 7]), st.integers(-99, 99), units),
    st.floats(),
    st.text(max_size=5),
)


@st.composite
def sections(draw: st.DrawFn) -> tuple[str, dict[str, Any]]:
    """Draw a section of a shipped scene with a few values or keys changed."""
    document = copy.deepcopy(draw(st.sampled_from(SHIPPED)))
    name = draw(st.sampled_from(sorted(document.keys() & SCHEMAS.keys())))
    for _ in range(draw(st.integers(1, 3))):
        table = draw(st.sampled_from(list(_tables(document[name]))))
        key = draw(st.sampled_from(sorted(table) or KEYS) | st.sampled_from(KEYS))
        if draw(st.integers(0, 4)):
            # Hypothesis draws the same dict again, which must not become part of itself.
            table[key] = copy.deepcopy(draw(written))
        else:
            table.pop(key, None)
    return name, document[name]


def _tables(table: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield table
    for inner in table.values():
        if isinstance(inner, dict):
            yield from _tables(inner)


@settings(max_examples=100)
@given(sections())
def test_any_section_is_refused_in_one_line_or_can_be_built(
    section: tuple[str, dict[str, Any]],
) -> None:
    name, table = section
    try:
        scene = validate(table, SCHEMAS[name], where="scene")
        if isinstance(scene, DisplayScene):
            display = Display(scene, "test")
            assert all(np.isfinite(display.tick(tick * scene.tick_ns).felt_n) for tick in range(3))
        elif isinstance(scene, SensingScene):
            source = build_source(scene, ROOT / "scenes")
            describe_stream(scene, source)
            assert np.isfinite(source.take(20).astype("<f4")).all()
    except (SceneError, SourceError) as error:
        check_line(error)


@given(st.lists(st.tuples(st.sampled_from(KEYS), written | st.just("1 ms")), max_size=4))
def test_a_link_with_anything_in_it(parts: list[tuple[str, object]]) -> None:
    text = ",".join(f"{key}={value}" for key, value in parts)
    try:
        link = parse_link(text)
    except SceneError as error:
        check_line(error)
    else:
        assert parse_link(link.text()) == link


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("channel = 0xffffffffffffffff", "channel"),
        ("late_target = 0x" + "f" * 6000, "late_target"),
        ("x = [0, {y = -9223372036854775809}]", "x.1.y"),
    ],
    ids=["64 bits", "thousands of digits", "within"],
)
def test_an_integer_that_toml_does_not_have(tmp_path: Path, text: str, place: str) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(f"[display]\n{text}", encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        load_document(path)
    assert str(caught.value) == f"{path}: display.{place}: an integer of more than 64 bits"


@pytest.mark.parametrize("text", ["delay=1ms,delay.x=3", "delay.x=3,delay=1ms"])
def test_a_key_is_a_table_or_a_value(text: str) -> None:
    with pytest.raises(SceneError, match="delay is given as a table and as a value"):
        parse_link(text)


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        ("actuator", "rotor_resonance", "1e-15 Hz"),
        ("actuator", "tip_radius", "1e-99 m"),
        ("actuator", "fingertip", "1e-20 N/m"),
        ("controller", "kp", 1e308),
    ],
)
def test_numbers_that_no_bench_has_are_refused(name: str, key: str, value: object) -> None:
    table = load_document(RADIAL)["display"]
    table[name][key] = value
    with pytest.raises(SceneError, match=f"{name}.*{key}: must be"):
        validate(table, DisplayScene, where="scene")
