import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from protocol.summary import tables
from protocol.summary.rows import print_summary, write_json
from protocol.summary.tables import Availability, Limited, Limits, Summary
from tests.support.full_summary import full_summary

LATE_US = tables.Lateness(60.0, 900.0, 5_000.0, 52_344.0, ["p999"])
NEVER = Limited(0, 0.0, 0.0)


def printed(summary: Summary) -> str:
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
    assert table.pop("rejected") == table.pop("hardware") == {}
    assert table.pop("faults") == table.pop("windows") == table["loop"].pop("realtime") == []
    delays, loop = (table["one_way_delay_ms"], table["playout_delay_ms"]), table["loop"]
    for quantiles in (*delays, loop["tick_us"], loop["late_us"]):
        assert quantiles.pop("beyond") == []
    assert set(leaves(table)) == {None}


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_figure_that_is_not_finite_is_null(value: float) -> None:
    summary = Summary(
        covered_delay_ms=value,
        force_rmse_n=tables.AlignedErrors(aligned=value),
        loop=tables.Loop(tick_us=tables.TickTime(p50=value)),
    )
    table = summary.to_dict()
    assert table["covered_delay_ms"] is None
    assert table["force_rmse_n"]["aligned"] is None
    assert table["loop"]["tick_us"]["p50"] is None


@pytest.mark.parametrize(
    "summary", [Summary(), full_summary(), Summary(speed=math.nan), Summary(faults=["zu spät"])]
)
def test_the_file_holds_the_summary(summary: Summary, tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_json(summary, path)

    def refuse(word: str) -> float:
        raise AssertionError(f"{word} is not JSON")

    text = path.read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=refuse) == summary.to_dict()
    assert text.endswith("}\n")


@pytest.mark.parametrize(
    ("summary", "row", "text"),
    [
        (
            Summary(
                samples=tables.SampleCounts(
                    sent=1000, played=750, predicted=200, late=30, lost=20, before_joining=7
                )
            ),
            "samples",
            "1000 sent = 750 in time + 200 felt ahead + 30 late + 20 lost",
        ),
        (
            Summary(
                availability=Availability(
                    60.5, 0.167, 0.005, 0.805, 0.022, 0.001, 0.0, 0.0, played=0.172, judged=0.167
                )
            ),
            "availability",
            "felt 16.7 %, starting 0.5 %, stale 80.5 %, faulted 2.2 %, waiting 0.1 % of 60.5 s",
        ),
        (
            Summary(
                limited=Limits(
                    force=Limited(312, 4.1, 0.205),
                    slew=Limited(1, 0.02, 0.0001),
                    travel=Limited(0, 0.0, 0.0),
                )
            ),
            "at a limit",
            "force limit 312 times, 4.1 s (20.5 % of the run);"
            " slew limit 1 time, 20 ms (< 0.1 % of the run)",
        ),
        (
            Summary(rejected={"truncated": 2, "duplicate": 400}),
            "rejected",
            "400 duplicate: samples or set-points that had arrived already",
        ),
        (Summary(clock=tables.Clock(offset_ms=-5e6)), "clock", "offset -5000.000 s"),
        (
            Summary(loop=tables.Loop(late_us=LATE_US)),
            "tick lateness",
            "p50 60 µs, p99 900 µs, p99.9 > 5000 µs, max 52344 µs",
        ),
        (
            Summary(one_way_delay_ms=tables.OneWayDelay(20.0, 2_000.0, 2_500.0, ["p99"])),
            "one-way delay",
            "p50 20.00 ms, p99 > 2000.00 ms, max 2500.00 ms",
        ),
        (Summary(loop=tables.Loop(1, 1)), "loop", "1 tick, 1 deadline miss"),
        (Summary(samples=tables.SampleCounts(before_joining=1)), "joined", "after 1 sample"),
    ],
    ids=[
        "account",
        "availability",
        "limits",
        "rejected",
        "clocks of two hosts",
        "uncounted lateness",
        "uncounted delay",
        "tick",
        "sample",
    ],
)
def test_a_row_names_what_its_figures_mean(summary: Summary, row: str, text: str) -> None:
    assert rows(printed(summary))[row] == text


def test_a_row_without_a_value_is_left_out() -> None:
    assert rows(printed(Summary())) == {"rejected": "nothing", "faults": "none"}
    partly = Summary(
        samples=tables.SampleCounts(sent=5),
        speed=math.nan,
        within_jnd=1.0,
        force_rmse_n=tables.AlignedErrors(in_phase=0.001),
        strain_rmse=tables.AlignedErrors(in_phase=math.nan),
    )
    assert rows(printed(partly)) == {
        "samples": "5 sent",
        "force RMSE": "in phase 1.000 mN",
        # The summary of a node that did not send of how much of its run.
        "within JND": "100.0 % of the time judged",
        "rejected": "nothing",
        "faults": "none",
    }


@pytest.mark.parametrize("text", ["2–3 mm off", "no [actuator]", "[/red] is no end", "[bold]"])
def test_texts_are_printed_without_markup(text: str) -> None:
    assert rows(printed(Summary(faults=[text])))["faults"] == text
