"""The doctor's visit: read the host, try the measures, measure ticks, judge, report.

It leaves the host as it was: every measure is taken back, and of files only its report is written.
"""

import dataclasses
import json as json_format
from collections.abc import Mapping, Sequence
from pathlib import Path

import zmq
from rich.console import Console
from rich.table import Table
from rich.text import Text

from display_node.display import Display
from display_node.doctor.host import (
    BARE,
    IDLE,
    LOADED,
    TOGETHER,
    Host,
    HostFindings,
    HostVerdict,
    describe,
    judge,
    read_host,
    stolen,
)
from display_node.doctor.jitter import Ticks, Work, busy_processes, run_in_turns
from display_node.scene import DisplayScene
from protocol import sockets
from protocol.config.scene import load_section
from protocol.histogram import bound
from protocol.host.output import write_whole
from protocol.host.process import freeze_objects
from protocol.host.realtime import RealtimeGrant, RealtimeRequest, hold, parse_realtime

SECONDS = 30.0
MAX_ROUNDS = 4
LEAST_SLOT_S = 0.1
TICKS_WIDTH = 72
QUANTILES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}


def run_doctor(
    scene: Path | None, seconds: float | None, console: Console, json: Path | None
) -> None:
    """Measure for `seconds` (30 s where None) at the tick of a scene, or at 1 ms without one.

    Raises SceneError, and OutputError when `json` cannot be written.
    """
    seconds = seconds or SECONDS
    tick_ns, work = _tick_of(scene)
    host = read_host()
    _print_rows("this host", describe(host), console)
    held = _try(host)
    refused = [(refusal.name, "not granted") for refusal in held.refused]
    _print_rows("\n--realtime", [*held.granted.items(), *refused], console)
    processors = len(host.cpus) or 1
    console.print(
        f"\nticks of {tick_ns * 1e-6:g} ms, {seconds:g} s in all, beside nothing and beside"
        f" {processors} busy processes"
    )
    # As a node does before its loop.
    freeze_objects()
    findings = _measure(tick_ns, work, held, seconds, processors, host.isolated)
    verdict = judge(host, findings)
    _print_ticks(findings.ticks, console)
    console.print(f"\n{verdict.status}: {verdict.reason}")
    for line in verdict.advice:
        console.print(f"- {line}")
    if json is not None:
        _write(json, host, held, findings, verdict)


def _tick_of(scene: Path | None) -> tuple[int, Work]:
    """Return the tick of a scene in ns, and what a waiting display does in one."""
    if scene is None:
        return DisplayScene.model_fields["tick_ns"].default, lambda due_ns, elapsed: None
    section = load_section(scene, "display", DisplayScene)
    return section.tick_ns, Display(section, "doctor").tick


def _try(host: Host) -> RealtimeGrant:
    """Take each measure for a moment; return which were granted and which refused."""
    words = ["slack", "lock", "fifo"]
    if host.isolated:
        words.append(f"cpu={host.isolated.rpartition(',')[2].rpartition('-')[2]}")
    elif len(host.cpus) > 1:
        # Interrupts come to the first by default.
        words.append(f"cpu={host.cpus[-1]}")
    tried = RealtimeGrant()
    for word in words:
        with hold(parse_realtime(word)) as held:
            tried.granted |= held.granted
            tried.refused += held.refused
    return tried


def _measure(
    tick_ns: int, work: Work, held: RealtimeGrant, seconds: float, processors: int, isolated: str
) -> HostFindings:
    """Return ticks bare, with each granted measure, and with all of them.

    A processor is chosen only where one is isolated: another one is no better by itself.
    """
    chosen = [name for name in held.granted if isolated or not name.startswith("cpu")]
    wishes = {BARE: RealtimeRequest()} | {name: parse_realtime(name) for name in held.granted}
    if chosen:
        wishes[TOGETHER] = parse_realtime(",".join(chosen))
    each_s = seconds / (2 * len(wishes))
    rounds = min(max(round(each_s / LEAST_SLOT_S), 1), MAX_ROUNDS)
    slot_s = each_s / rounds
    context: sockets.Context = zmq.Context()
    try:
        silent = sockets.unconnected(context, zmq.SUB)
        waited_on = sockets.descriptors([silent])
        stolen_before, all_before = stolen()
        with busy_processes(processors):
            loaded = run_in_turns(wishes, rounds, slot_s, tick_ns, waited_on, work)
        idle = run_in_turns(wishes, rounds, slot_s, tick_ns, waited_on, work)
        stolen_after, all_after = stolen()
    finally:
        context.destroy(linger=0)
    return HostFindings(
        tick_ns=tick_ns,
        ticks={(name, IDLE): ticks for name, ticks in idle.items()}
        | {(name, LOADED): ticks for name, ticks in loaded.items()},
        option=",".join(chosen) or None,
        refusals=[str(refusal) for refusal in held.refused],
        stolen=(stolen_after - stolen_before) / max(1, all_after - all_before),
    )


def _print_rows(title: str, rows: Sequence[tuple[str, str]], console: Console) -> None:
    table = Table(title=title, show_header=False, title_justify="left", box=None, pad_edge=False)
    for name, text in rows:
        table.add_row(name, Text(text))
    console.print(table)


def _print_ticks(found: Mapping[tuple[str, str], Ticks], console: Console) -> None:
    title = "how late ticks began, in µs"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for position, column in enumerate(("with", "beside", *_figures(Ticks()))):
        table.add_column(column, justify="left" if position < 2 else "right")
    for (name, beside), ticks in found.items():
        beyond = ticks.late_us.beyond(**QUANTILES)
        figures = (
            "–" if value is None else f"{bound(key, beyond)}{value:.0f}"
            for key, value in _figures(ticks).items()
        )
        table.add_row(name, beside, *figures)
    # Not cut, however narrow the terminal.
    console.print(table, width=max(console.width, TICKS_WIDTH), crop=False)


def _figures(ticks: Ticks) -> dict[str, float | None]:
    late_us = ticks.late_us
    return {
        "ticks": ticks.due,
        "missed": ticks.missed,
        **{name: late_us.quantile(share) for name, share in QUANTILES.items()},
        "max": late_us.maximum,
    }


def _write(
    path: Path, host: Host, held: RealtimeGrant, findings: HostFindings, verdict: HostVerdict
) -> None:
    report = {
        "host": dataclasses.asdict(host),
        "granted": held.granted,
        "refused": [dataclasses.asdict(refusal) for refusal in held.refused],
        "tick_ms": findings.tick_ns * 1e-6,
        "late_us": [
            {"with": name, "beside": beside}
            | _figures(ticks)
            | {"beyond": ticks.late_us.beyond(**QUANTILES)}
            for (name, beside), ticks in findings.ticks.items()
        ],
        "stolen": findings.stolen,
        "verdict": dataclasses.asdict(verdict),
    }
    write_whole(path, json_format.dumps(report, indent=2) + "\n")
