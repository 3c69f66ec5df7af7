"""Each figure of a summary: its surfaces, and its form in rows and in the file."""

import copy
import io
import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from protocol.faults import Fault, FaultKind, Note, Part
from protocol.finger import FingerState
from protocol.summary import fields
from protocol.summary.fields import Summary, read_summary
from protocol.summary.figures import Figure, Surface, figures
from protocol.summary.rows import cells, print_summary, write_json
from protocol.wire.telemetry import Status
from telepulse.metrics.server import NodeState, families
from telepulse.view import text as page
from telepulse.view.live import LiveState
from telepulse.view.window_data import window_scores
from tests.support.full_summary import full_summary

Json = dict[str, Any]


def printed(summary: Json) -> str:
    console = Console(file=io.StringIO(), width=1_000, record=True)
    print_summary(read_summary(summary), console)
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
        inner[name] = [{key: _other(found) for key, found in value[0].items()}]
    elif isinstance(value, list):
        inner[name] = ["another word"]
    else:
        inner[name] = _other(value)
    return other


def _other(value: Any) -> Any:
    if not isinstance(value, str):
        return value + 7
    others = {"silent": "late", "film": "drive", "sensor": "drive", "under way": "unconfirmed"}
    return others.get(value, "another text")


@pytest.mark.parametrize("surface", Surface)
def test_a_figure_is_on_a_surface_or_absent_for_a_reason(surface: Surface) -> None:
    show, summary = SURFACES[surface], full_summary().to_dict()
    before = show(summary)
    for each in figures():
        if surface in each.absent:
            assert each.absent[surface].endswith("."), each.key
        else:
            assert show(changed(summary, each)) != before, each.key


def printed_rows(summary: Summary) -> str:
    out = io.StringIO()
    print_summary(summary, Console(file=out, width=200))
    return out.getvalue()


def rows(text: str) -> dict[str, str]:
    """The printed rows by their names, which end where two spaces are."""
    parts = (line.partition("  ") for line in text.splitlines())
    return {name: value.strip() for name, _, value in parts}


def leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [leaf for inner in value.values() for leaf in leaves(inner)]
    return [value]


def test_figures_that_do_not_apply_are_null() -> None:
    table = Summary().to_dict()
    assert table.pop("rejected") == table.pop("rejected_readers") == table.pop("hardware") == {}
    assert table["loop"].pop("realtime") == []
    assert [table.pop(key) for key in ("faults", "notes", "waiting_for", "windows")] == [[]] * 4
    delays, loop = (table["one_way_delay_ms"], table["playout_delay_ms"]), table["loop"]
    for quantiles in (*delays, loop["command_us"], loop["tick_us"], loop["late_us"]):
        assert quantiles.pop("beyond") == []
    assert set(leaves(table)) == {None}


@pytest.mark.parametrize(
    "summary",
    [
        Summary(),
        full_summary(),
        Summary(speed=math.nan),
        Summary(loop=fields.Loop(tick_us=fields.TickTime(p50=math.inf))),
        Summary(faults=[Fault(FaultKind.LATE, Part.FILM, "zu spät", 5, "cun")]),
    ],
)
def test_the_file_holds_the_summary(summary: Summary, tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_json(summary, path)

    def refuse(word: str) -> float:
        raise AssertionError(f"{word} is not JSON")

    text = path.read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=refuse) == summary.to_dict()
    assert text.endswith("}\n")


@pytest.mark.parametrize("text", ["2–3 mm off", "no [actuator]", "[/red] is no end", "[bold]"])
def test_texts_are_printed_without_markup(text: str) -> None:
    fault = Fault(FaultKind.UNKNOWN, Part.UNKNOWN, text)
    assert rows(printed_rows(Summary(faults=[fault])))["faults"] == text


def test_a_summary_with_faults_and_notes_is_read_as_it_was_written() -> None:
    whole = full_summary()
    assert read_summary(json.loads(json.dumps(whole.to_dict()))) == whole


def test_the_texts_of_an_earlier_version_are_read_as_records() -> None:
    old = Summary().to_dict()
    del old["notes"]
    old["faults"] = ["guan: feedback lost", "film's sensor: 3 missing", "sensing node: 2 too much"]
    old["finger"] = "pressed with 245 mN"
    old["contactors"] = {"guan": {"finger": "withdrawn"}}
    old["waiting_for"] = "nobody listens at tcp://wrist:5555"
    found = read_summary(old)
    assert found.faults == [Fault(FaultKind.UNKNOWN, Part.UNKNOWN, "guan: feedback lost")]
    assert str(found.faults[0]) == "guan: feedback lost"
    assert found.notes == [Note(Part.FILM, "3 missing"), Note(Part.SENSOR, "2 too much")]
    assert [reason.text for reason in found.waiting_for] == [old["waiting_for"]]
    assert found.finger == found.contactors["guan"].finger == FingerState()
    # A recording leaves out what has no value.
    assert read_summary({}) == read_summary({"faults": [], "waiting_for": None}) == Summary()


def test_a_kind_of_a_later_version_is_unknown() -> None:
    new = Fault(FaultKind.LATE, Part.FILM, "it is odd", 5, "cun").to_dict()
    (fault,) = read_summary({"notes": [], "faults": [new | {"kind": "odd", "part": "x"}]}).faults
    assert fault == Fault(FaultKind.UNKNOWN, Part.UNKNOWN, "it is odd", 5, "cun")


def test_after_a_fault_the_rows_of_the_felt_pulse_are_of_before() -> None:
    whole = full_summary()
    assert "before the fault" not in printed_rows(replace(whole, faults=[]))
    found = rows(printed_rows(whole))
    of_felt = {name for name, text in found.items() if text.startswith("before the fault: ")}
    assert of_felt == {
        *(
            "playout delay",
            "covered delay",
            "felt ahead",
            "prediction trusted",
            "prediction",
            "force RMSE",
        ),
        *("strain RMSE", "within JND", "above 25 Hz"),
    }
    assert "predicted" in found["samples"]
    assert "felt ahead" not in found["samples"]
    several = replace(whole, contactors={"cun": whole})
    assert "cun: before the fault: off by" in printed_rows(several)
