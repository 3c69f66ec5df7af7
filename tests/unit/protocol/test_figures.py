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
from protocol.figures import (
    MILLISECONDS,
    NEWTONS,
    PPM,
    SHARE,
    STRAIN,
    Figure,
    Registry,
    Surface,
    Unit,
)
from protocol.run_summary import REGISTRY, Summary, print_summary
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
    Surface.REPORT: lambda summary: str(REGISTRY.cells(summary, Surface.REPORT)),
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
    for each in REGISTRY.figures:
        if surface in each.absent:
            assert each.absent[surface].endswith("."), each.key
        else:
            assert show(changed(summary, each)) != before, each.key


def test_every_key_of_the_json_is_a_figure_in_the_reference() -> None:
    def keys(value: Any, before: str = "") -> list[str]:
        if isinstance(value, dict) and value:
            return [key for name in value for key in keys(value[name], f"{before}.{name}")]
        return [before.removeprefix(".")]

    assert sorted(keys(Summary().to_dict())) == sorted(each.key for each in REGISTRY.figures)
    reference = summary_keys.write()
    assert all(f"| `{each.key}` |" in reference for each in REGISTRY.figures)
    assert all(reason in reference for each in REGISTRY.figures for reason in each.absent.values())


@pytest.mark.parametrize(
    ("unit", "value", "text"),
    [
        (MILLISECONDS, -0.004, "0.00 ms"),
        (MILLISECONDS, -0.006, "-0.01 ms"),
        (NEWTONS, -4e-7, "0.000 mN"),
        (PPM, -0.0, "0.0 ppm"),
        (SHARE, -1e-6, "0.0 %"),
        (STRAIN, -0.0, "0.000e+00"),
    ],
)
def test_a_value_that_rounds_to_zero_has_no_sign(unit: Unit, value: float, text: str) -> None:
    assert unit.text(value) == text


def test_a_field_without_a_figure_is_refused() -> None:
    @dataclass(frozen=True, slots=True)
    class Bare(Summary):
        secret: float | None = None

    with pytest.raises(TypeError, match=r"Bare\.secret has no Figure"):
        Registry(Bare)


def test_each_metric_is_of_one_figure() -> None:
    names = [
        (each.metric, tuple(sorted(each.labels.items()))) for each in REGISTRY.on(Surface.METRICS)
    ]
    assert all(name for name, _ in names)
    assert len(set(names)) == len(names)
