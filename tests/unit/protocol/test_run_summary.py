import io
import json
import math
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from protocol.counters import Availability, Interruptions, Limited, Limits
from protocol.errors import OutputError
from protocol.host.output import check_writable
from protocol.run_summary import Summary, print_summary, write_json
from protocol.summary_tables import (
    AlignedErrors,
    Clock,
    Compensation,
    Deadlines,
    FrameCounts,
    Lateness,
    Loop,
    OneWayDelay,
    PlayoutDelay,
    Reconnections,
    Roughness,
    SampleCounts,
    TickTime,
)

NEVER = Limited(0, 0.0, 0.0)
FULL = Summary(
    samples=SampleCounts(sent=1000, played=950, late=30, lost=20, before_joining=7),
    frames=FrameCounts(received=196, reordered=3, copies=392, first={"tcp://one:5555": 190}),
    reconnections=Reconnections(opened=3, kept=2, control=1),
    one_way_delay_ms=OneWayDelay(p50=20.12, p99=35.5, max=41.0),
    playout_delay_ms=PlayoutDelay(mean=42.0, p99=45.0),
    covered_delay_ms=44.5,
    compensation=Compensation(predicted=0.25, trusted=0.125),
    clock=Clock(
        offset_ms=-12.3456, skew_ppm=50.25, uncertainty_ms=0.125, asymmetry_ms=17.5, steps=1
    ),
    force_rmse_n=AlignedErrors(aligned=0.00025, in_phase=0.0301),
    strain_rmse=AlignedErrors(aligned=9.4249e-9, in_phase=5.7802e-8),
    within_jnd=0.875,
    roughness=Roughness(felt_n=0.0006, sensed_n=0.0005, energy_ratio=1.44),
    limited=Limits(force=Limited(312, 4.1, 0.205), slew=Limited(1, 0.02, 0.0001), travel=NEVER),
    loop=Loop(
        ticks=5000,
        deadline_misses=2,
        tick_us=TickTime(p50=85.0, p99=140.0),
        late_us=Lateness(p50=40.5, p99=96.5, p999=233.5, max=448.0),
        late=False,
        last_5s=Deadlines(missed=0.0, gap_ms=1.0),
        worst_5s=Deadlines(missed=0.0125, gap_ms=63.0),
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


def printed(summary: Summary, title: str = "display-node") -> str:
    out = io.StringIO()
    print_summary(summary, title, Console(file=out, width=200))
    return out.getvalue()


def rows(text: str) -> dict[str, str]:
    """The printed rows by their names, which end where two spaces are."""
    parts = (line.partition("  ") for line in text.splitlines()[1:])
    return {name: value.strip() for name, _, value in parts}


def leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [leaf for inner in value.values() for leaf in leaves(inner)]
    return [value]


def test_figures_that_do_not_apply_are_null() -> None:
    table = Summary().to_dict()
    assert table.pop("rejected") == table.pop("hardware") == {}
    assert table.pop("faults") == table["loop"].pop("realtime") == []
    delays, loop = (table["one_way_delay_ms"], table["playout_delay_ms"]), table["loop"]
    for quantiles in (*delays, loop["tick_us"], loop["late_us"]):
        assert quantiles.pop("beyond") == []
    assert set(leaves(table)) == {None}


def test_known_figures_are_in_the_json() -> None:
    table = FULL.to_dict()
    samples = {"sent": 1000, "played": 950, "late": 30, "lost": 20, "before_joining": 7}
    assert table["samples"] == samples
    assert table["loop"]["tick_us"] == {"p50": 85.0, "p99": 140.0, "beyond": []}
    assert table["rejected"] == {"truncated": 2, "duplicate": 400}
    assert table["faults"] == ["silence", "force limit"]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_figure_that_is_not_finite_is_null(value: float) -> None:
    summary = Summary(
        covered_delay_ms=value,
        force_rmse_n=AlignedErrors(aligned=value),
        loop=Loop(tick_us=TickTime(p50=value)),
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


def test_a_file_that_cannot_be_written_is_refused_before_and_after(tmp_path: Path) -> None:
    for path in (tmp_path / "no such folder" / "out.json", tmp_path):
        with pytest.raises(OutputError) as before:
            check_writable(path)
        with pytest.raises(OutputError) as after:
            write_json(FULL, path)
        for caught in (before, after):
            assert str(caught.value).startswith(f"{path}: cannot be written: ")
            assert "\n" not in str(caught.value)


def test_checking_a_writable_file_leaves_it_as_it_is(tmp_path: Path) -> None:
    check_writable(tmp_path / "out.json")
    check_writable(None)
    assert list(tmp_path.iterdir()) == []


def test_the_printed_rows() -> None:
    assert rows(printed(FULL)) == {
        "samples": "1000 sent = 950 played + 30 late + 20 lost",
        "joined": "after 7 samples",
        "frames": "196 received, 3 out of order, 392 copies over further paths,"
        " 190 first over tcp://one:5555",
        "reconnections": "3 opened beside a silent connection, 2 of them kept, 1 for control",
        "one-way delay": "p50 20.12 ms, p99 35.50 ms, max 41.00 ms",
        "playout delay": "mean 42.00 ms, p99 45.00 ms",
        "covered delay": "44.50 ms from the wrist to the force at the finger",
        "concealed": "25.0 % of the time played (played: 17.2 % of the run)",
        "prediction trusted": "12.5 % of the time played (played: 17.2 % of the run)",
        "clock": "offset -12.346 ms, skew 50.2 ppm, uncertainty 0.125 ms, 1 step",
        "force RMSE": "aligned 0.250 mN, in phase 30.100 mN",
        "strain RMSE": "aligned 9.425e-09, in phase 5.780e-08",
        "availability": "felt 16.7 %, starting 0.5 %, stale 80.5 %, faulted 2.2 %, waiting 0.1 %"
        " of 60.5 s",
        "interruptions": "3 times, 4.25 s in all, the longest 2.60 s",
        "within JND": "87.5 % of the time judged (judged: 16.7 % of the run)",
        "above 25 Hz": "felt 0.600 mN, sensed 0.500 mN, energy ratio 1.44",
        "at a limit": "force limit 312 times, 4.1 s (20.5 % of the run);"
        " slew limit 1 time, 20 ms (< 0.1 % of the run)",
        "loop": "5000 ticks, 2 deadline misses",
        "worst 5 s": "1.25 % of the ticks missed, longest gap 63 ms",
        "tick cost": "p50 85 µs, p99 140 µs",
        "tick lateness": "p50 40 µs, p99 96 µs, p99.9 234 µs, max 448 µs",
        "real-time measures": "slack, fifo=40",
        "speed": "312 times real time",
        "rejected": "400 duplicate: samples that had arrived already",
        "": "2 truncated: messages that end too early; the peer is no node, or bytes were lost",
        "hardware": "3 film crc",
        "faults": "silence; force limit",
        "finger": "withdrawn",
        "finger's stiffness": "1.90 times the scene's fingertip",
    }
    assert printed(FULL).splitlines()[0].strip() == "display-node"


def test_clocks_of_two_hosts_are_shown_in_seconds() -> None:
    shown = rows(printed(Summary(clock=Clock(offset_ms=-5e6))))
    assert shown["clock"] == "offset -5000.000 s"


def test_a_quantile_beyond_what_is_counted_is_a_lower_bound() -> None:
    late_us = Lateness(60.0, 900.0, 5_000.0, 52_344.0, beyond=["p999"])
    shown = rows(printed(Summary(loop=Loop(1, 1, TickTime(1.0, 2.0), late_us))))
    assert shown["tick lateness"] == "p50 60 µs, p99 900 µs, p99.9 > 5000 µs, max 52344 µs"
    delay = OneWayDelay(20.0, 2_000.0, 2_500.0, beyond=["p99"])
    shown = rows(printed(Summary(one_way_delay_ms=delay)))
    assert shown["one-way delay"] == "p50 20.00 ms, p99 > 2000.00 ms, max 2500.00 ms"


def test_a_count_of_one_is_singular() -> None:
    shown = rows(printed(Summary(samples=SampleCounts(1, before_joining=1), loop=Loop(1, 1))))
    assert shown["loop"] == "1 tick, 1 deadline miss"
    assert shown["joined"] == "after 1 sample"


def test_a_row_without_a_value_is_left_out() -> None:
    assert rows(printed(Summary())) == {"rejected": "nothing", "faults": "none"}
    partly = Summary(
        samples=SampleCounts(sent=5),
        speed=math.nan,
        within_jnd=1.0,
        force_rmse_n=AlignedErrors(in_phase=0.001),
        strain_rmse=AlignedErrors(in_phase=math.nan),
    )
    assert rows(printed(partly)) == {
        "samples": "5 sent",
        "force RMSE": "in phase 1.000 mN",
        # The summary of a node that did not send of how much of its run.
        "within JND": "100.0 % of the time judged",
        "rejected": "nothing",
        "faults": "none",
    }


@pytest.mark.parametrize("fault", ["2–3 mm off", "no [actuator]", "[/red] is no end", "[bold]"])
def test_a_fault_is_printed_as_it_is(fault: str) -> None:
    assert rows(printed(Summary(faults=[fault])))["faults"] == fault


def test_a_title_is_printed_as_it_is() -> None:
    assert "[sensing] of [/x]" in printed(FULL, "[sensing] of [/x]")
