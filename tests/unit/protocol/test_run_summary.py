import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from protocol import loop_tables
from protocol import summary_tables as tables
from protocol.counters import Availability, Interruptions, Limited, Limits
from protocol.run_summary import Summary, print_summary, write_json

LATE_US = loop_tables.Lateness(60.0, 900.0, 5_000.0, 52_344.0, ["p999"])
NEVER = Limited(0, 0.0, 0.0)
FULL = Summary(
    samples=tables.SampleCounts(
        sent=1000, played=750, predicted=200, late=30, lost=20, before_joining=7
    ),
    frames=tables.FrameCounts(received=196, reordered=3, copies=392, first={"tcp://one:5555": 190}),
    data_connections=tables.DataConnections(open=3),
    reconnections=tables.Reconnections(opened=3, kept=2, control=1),
    one_way_delay_ms=tables.OneWayDelay(p50=20.12, p99=35.5, max=41.0),
    playout_delay_ms=tables.PlayoutDelay(mean=42.0, p99=45.0),
    covered_delay_ms=44.5,
    compensation=tables.Compensation(0.25, 36.12, 0.125, 0.00259, 0.0084, 2, 1.94, 0.01, False),
    clock=tables.Clock(
        offset_ms=-12.3456, skew_ppm=50.25, uncertainty_ms=0.125, asymmetry_ms=17.5, steps=1
    ),
    force_rmse_n=tables.AlignedErrors(aligned=0.00025, in_phase=0.0301),
    strain_rmse=tables.AlignedErrors(aligned=9.4249e-9, in_phase=5.7802e-8),
    within_jnd=0.875,
    roughness=tables.Roughness(felt_n=0.0006, sensed_n=0.0005, energy_ratio=1.44),
    limited=Limits(force=Limited(312, 4.1, 0.205), slew=Limited(1, 0.02, 0.0001), travel=NEVER),
    loop=loop_tables.Loop(
        ticks=5000,
        deadline_misses=2,
        tick_us=loop_tables.TickTime(p50=85.0, p99=140.0),
        late_us=loop_tables.Lateness(p50=40.5, p99=96.5, p999=233.5, max=448.0),
        late=False,
        last_5s=loop_tables.Deadlines(missed=0.0, gap_ms=1.0),
        worst_5s=loop_tables.Deadlines(missed=0.0125, gap_ms=63.0),
        realtime=["slack", "fifo=40"],
    ),
    speed=312.0,
    rejected={"truncated": 2, "duplicate": 400},
    hardware={"film crc": 3},
    availability=Availability(
        60.5, 0.167, 0.005, 0.805, 0.022, 0.001, 0.0, 0.0, played=0.172, judged=0.167
    ),
    interruptions=Interruptions(3, 4.25, 2.6, 57.0, 57.35),
    faults=["silence", "force limit"],
    finger="withdrawn",
    finger_stiffness=1.9,
)


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
        loop=loop_tables.Loop(tick_us=loop_tables.TickTime(p50=value)),
    )
    table = summary.to_dict()
    assert table["covered_delay_ms"] is None
    assert table["force_rmse_n"]["aligned"] is None
    assert table["loop"]["tick_us"]["p50"] is None


@pytest.mark.parametrize(
    "summary", [Summary(), FULL, Summary(speed=math.nan), Summary(faults=["zu spät"])]
)
def test_the_file_holds_the_summary(summary: Summary, tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_json(summary, path)

    def refuse(word: str) -> float:
        raise AssertionError(f"{word} is not JSON")

    text = path.read_text(encoding="utf-8")
    assert json.loads(text, parse_constant=refuse) == summary.to_dict()
    assert text.endswith("}\n")


def test_the_printed_rows() -> None:
    assert rows(printed(FULL)) == {
        "samples": "1000 sent = 750 in time + 200 felt ahead + 30 late + 20 lost",
        "joined": "after 7 samples",
        "frames": "196 received, 3 out of order, 392 copies over further paths,"
        " 190 first over tcp://one:5555",
        "data connections": "3 open",
        "reconnections": "3 opened beside a silent connection, 2 of them kept, 1 for control",
        "one-way delay": "p50 20.12 ms, p99 35.50 ms, max 41.00 ms",
        "playout delay": "mean 42.00 ms, p99 45.00 ms",
        "covered delay": "44.50 ms from the wrist to the force at the finger",
        "felt ahead": "25.0 % of the time with a pulse (17.2 % of the run),"
        " on average 36.1 ms ahead",
        "prediction trusted": "12.5 % of the time with a pulse (17.2 % of the run)",
        "prediction": "off by 2.590 mN RMS, 0.8 % of the pulse's height, 2 corrections felt,"
        " 1.9 per minute",
        "clock": "offset -12.346 ms, skew 50.2 ppm, uncertainty 0.125 ms, 1 step",
        "force RMSE": "aligned 0.250 mN, in phase 30.100 mN",
        "strain RMSE": "aligned 9.425e-09, in phase 5.780e-08",
        "availability": "felt 16.7 %, starting 0.5 %, stale 80.5 %, faulted 2.2 %, waiting 0.1 %"
        " of 60.5 s",
        "interruptions": "3 times, 4.25 s in all, the longest 2.60 s",
        "within JND": "87.5 % of the time judged (16.7 % of the run)",
        "above 25 Hz": "felt 0.600 mN, sensed 0.500 mN, energy ratio 1.44",
        "at a limit": "force limit 312 times, 4.1 s (20.5 % of the run);"
        " slew limit 1 time, 20 ms (< 0.1 % of the run)",
        "loop": "5000 ticks, 2 deadline misses",
        "worst 5 s": "1.25 % of the ticks missed, longest gap 63 ms",
        "tick cost": "p50 85 µs, p99 140 µs",
        "tick lateness": "p50 40 µs, p99 96 µs, p99.9 234 µs, max 448 µs",
        "real-time measures": "slack, fifo=40",
        "speed": "312 times real time",
        "rejected": "400 duplicate: samples or set-points that had arrived already",
        "": "2 truncated: messages that end too early; the peer is no node, or bytes were lost",
        "hardware": "3 film crc",
        "faults": "silence; force limit",
        "finger": "withdrawn",
        "finger's stiffness": "1.90 times the scene's fingertip",
    }


@pytest.mark.parametrize(
    ("summary", "row", "text"),
    [
        (Summary(clock=tables.Clock(offset_ms=-5e6)), "clock", "offset -5000.000 s"),
        (
            Summary(loop=loop_tables.Loop(late_us=LATE_US)),
            "tick lateness",
            "p50 60 µs, p99 900 µs, p99.9 > 5000 µs, max 52344 µs",
        ),
        (
            Summary(one_way_delay_ms=tables.OneWayDelay(20.0, 2_000.0, 2_500.0, ["p99"])),
            "one-way delay",
            "p50 20.00 ms, p99 > 2000.00 ms, max 2500.00 ms",
        ),
        (Summary(loop=loop_tables.Loop(1, 1)), "loop", "1 tick, 1 deadline miss"),
        (Summary(samples=tables.SampleCounts(before_joining=1)), "joined", "after 1 sample"),
    ],
    ids=["clocks of two hosts", "uncounted lateness", "uncounted delay", "tick", "sample"],
)
def test_a_row_of_an_unusual_figure(summary: Summary, row: str, text: str) -> None:
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
