"""Each figure of a summary is on every surface, or left out for a reason."""

import copy
import io
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from pydantic import TypeAdapter
from rich.console import Console

from docs.ext import summary_keys
from protocol.summary.figures import Figure, Reader, Surface, figures, figures_on
from protocol.summary.phrases import UNITS
from protocol.summary.rows import cells, print_summary
from protocol.summary.tables import Summary
from protocol.wire.telemetry import Status
from telepulse.metrics.server import NodeState, families
from telepulse.view import text as page
from telepulse.view.live import LiveState
from telepulse.view.window_data import window_scores
from tests.support.full_summary import full_summary

Json = dict[str, Any]


def printed(summary: Json) -> str:
    console = Console(file=io.StringIO(), width=1_000, record=True)
    print_summary(TypeAdapter(Summary).validate_python(summary), console)
    return console.export_text()


def on_the_page(summary: Json) -> str:
    live = LiveState()
    live.summary = summary
    return str(page.figures(live, window_scores(live, 1)))


def scraped(summary: Json) -> str:
    node = NodeState(Status("playing", "", summary, False), 0)
    return str([metric.samples for metric in families("display-node", node, 0)])


SURFACES: dict[Surface, Callable[[Json], str]] = {
    Surface.SUMMARY: printed,
    Surface.PAGE: on_the_page,
    Surface.REPORT: lambda summary: str(cells(summary, Surface.REPORT)),
    Surface.METRICS: scraped,
}


def changed(summary: Json, figure: Figure) -> Json:
    """Return a copy of a summary in which one figure has another value."""
    other = copy.deepcopy(summary)
    *tables, name = figure.key.split(".")
    inner = other
    for each in tables:
        inner = inner[each]
    value = inner[name]
    if isinstance(value, bool):
        inner[name] = not value
    elif isinstance(value, dict):
        inner[name] = {"another name": 12}
    elif isinstance(value, list) and isinstance(value[0], dict):
        inner[name] = [{key: number + 7 for key, number in value[0].items()}]
    elif isinstance(value, list):
        inner[name] = ["another word"]
    else:
        inner[name] = "another text" if isinstance(value, str) else value + 7
    return other


@pytest.mark.parametrize("surface", Surface)
def test_a_figure_is_on_a_surface_or_absent_for_a_reason(surface: Surface) -> None:
    show, summary = SURFACES[surface], full_summary().to_dict()
    before = show(summary)
    for each in figures():
        if surface in each.absent:
            assert each.absent[surface].endswith("."), each.key
        else:
            assert show(changed(summary, each)) != before, each.key


def test_every_key_of_the_json_is_a_figure_in_the_reference() -> None:
    def keys(value: Any, before: str = "") -> list[str]:
        if isinstance(value, dict) and value:
            return [key for name in value for key in keys(value[name], f"{before}.{name}")]
        return [before.removeprefix(".")]

    assert sorted(keys(Summary().to_dict())) == sorted(each.key for each in figures())
    reference = summary_keys.write()
    assert all(f"| `{each.key}` |" in reference for each in figures())
    assert all(reason in reference for each in figures() for reason in each.absent.values())


@pytest.mark.parametrize(
    ("unit", "value", "text"),
    [
        ("ms", -0.004, "0.00 ms"),
        ("ms", -0.006, "-0.01 ms"),
        ("N", -4e-7, "0.000 mN"),
        ("ppm", -0.0, "0.0 ppm"),
        ("share", -1e-6, "0.0 %"),
        ("strain", -0.0, "0.000e+00"),
    ],
)
def test_a_value_that_rounds_to_zero_has_no_sign(unit: str, value: float, text: str) -> None:
    assert UNITS[unit].text(value) == text


@dataclass(frozen=True, slots=True)
class Bare:
    secret: float | None = None


@pytest.mark.parametrize(
    ("entries", "refusal"),
    [
        ({}, r"Bare\.secret has no entry"),
        ({"secret": {}, "other": {}}, "Bare has no other"),
        ({"secret": {"meanning": "misspelt"}}, "meanning"),
    ],
)
def test_each_field_has_an_entry_and_each_entry_a_field(entries: Json, refusal: str) -> None:
    with pytest.raises(TypeError, match=refusal):
        list(Reader({}, entries).figures(Bare))


def test_each_metric_is_of_one_figure() -> None:
    names = [
        (each.metric, tuple(sorted(each.labels.items()))) for each in figures_on(Surface.METRICS)
    ]
    assert all(name for name, _ in names)
    assert len(set(names)) == len(names)
