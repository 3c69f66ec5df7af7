"""`display-node --doctor`: the settings that this host grants a real-time loop, and its lateness.

It leaves the host as it was: each setting is undone, and the report is the only file written.
"""

import dataclasses
import json as json_format
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from display_node.display import Display
from display_node.doctor.host import Host, describe, read_host
from display_node.doctor.jitter import HostFindings, Ticks, Work, judge, measure
from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from protocol.histogram import bound
from protocol.host.output import write_whole
from protocol.host.process import freeze_objects
from protocol.host.realtime import RealtimeGrant, apply_realtime, parse_realtime

SECONDS = 30.0
TICKS_WIDTH = 72
QUANTILES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}
COLUMNS = ("ticks", "missed", *QUANTILES, "max")


def run_doctor(
    scene: Path | None, seconds: float | None, console: Console, json: Path | None
) -> None:
    """Measure for `seconds` (30 s where None) at the tick of a scene, or at 1 ms without one.

    Raises SceneError, and OutputError when `json` cannot be written.
    """
    seconds = seconds or SECONDS
    tick_ns: int = DisplayScene.model_fields["tick_ns"].default
    work: Work = lambda *_: None  # noqa: E731
    if scene is not None:
        section = load_section(scene, "display", DisplayScene)
        # The work of a tick while a display waits for its stream.
        tick_ns, work = section.tick_ns, Display(section, "doctor").tick
    host = read_host()
    _print_rows("this host", describe(host), console)
    held = _try_settings(host)
    refused = ((refusal.name, "not granted") for refusal in held.refused)
    _print_rows("\n--realtime", [*held.granted.items(), *refused], console)
    processors = len(host.cpus) or 1
    console.print(
        f"\nticks of {tick_ns * 1e-6:g} ms, {seconds:g} s in all, beside nothing and beside"
        f" {processors} busy processes"
    )
    # A node does the same before its loop.
    freeze_objects()
    findings = measure(tick_ns, work, held, seconds, processors, host.isolated)
    verdict = judge(host, findings)
    _print_ticks(findings, console)
    console.print(f"\n{verdict.status}: {verdict.reason}")
    for line in verdict.advice:
        console.print(f"- {line}")
    if json is None:
        return
    report = {
        "host": dataclasses.asdict(host),
        "granted": held.granted,
        "refused": [dataclasses.asdict(refusal) for refusal in held.refused],
        "tick_ms": findings.tick_ns * 1e-6,
        "late_us": [
            {"with": name, "beside": beside} | _figures(ticks)
            for (name, beside), ticks in findings.ticks.items()
        ],
        "stolen": findings.stolen,
        "verdict": dataclasses.asdict(verdict),
    }
    write_whole(json, json_format.dumps(report, indent=2) + "\n")


def _try_settings(host: Host) -> RealtimeGrant:
    """Apply each setting for a moment; return which were granted and which refused."""
    settings = ["slack", "lock", "fifo"]
    if host.isolated:
        settings.append(f"cpu={host.isolated.rpartition(',')[2].rpartition('-')[2]}")
    elif len(host.cpus) > 1:
        # The last one: by default, the first processor serves the interrupts.
        settings.append(f"cpu={host.cpus[-1]}")
    tried = RealtimeGrant()
    for name in settings:
        with apply_realtime(parse_realtime(name)) as held:
            tried.granted |= held.granted
            tried.refused += held.refused
    return tried


def _print_rows(title: str, rows: Iterable[tuple[str, str]], console: Console) -> None:
    table = Table(title=title, show_header=False, title_justify="left", box=None, pad_edge=False)
    for name, text in rows:
        table.add_row(name, Text(text))
    console.print(table)


def _print_ticks(findings: HostFindings, console: Console) -> None:
    title = "how late ticks began, in µs"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for position, column in enumerate(("with", "beside", *COLUMNS)):
        table.add_column(column, justify="left" if position < 2 else "right")
    for (name, beside), ticks in findings.ticks.items():
        figures = _figures(ticks)
        texts = (
            "–" if figures[key] is None else f"{bound(key, figures['beyond'])}{figures[key]:.0f}"
            for key in COLUMNS
        )
        table.add_row(name, beside, *texts)
    # The table is not cut, however narrow the terminal is.
    console.print(table, width=max(console.width, TICKS_WIDTH), crop=False)


def _figures(ticks: Ticks) -> dict[str, Any]:
    late_us, counts = ticks.late_us, {"ticks": ticks.due, "missed": ticks.missed}
    return counts | late_us.quantiles(**QUANTILES) | {"max": late_us.maximum}
