"""Missed ticks, tick cost and alerts of `telepulse demo` on two cores, without priority.

Each run is one with the page open in a real browser, or one without page and screen. With
`CALM_BEFORE` set to another checkout, its demo runs in turns with this one's.
"""

import json
import os
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.measure import show

HERE = Path(__file__).parents[1]
# Number of runs of each kind.
RUNS = int(os.environ.get("CALM_RUNS", "10"))
BROWSER = shutil.which("chromium")
QUIET = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--disable-quic"),
)
# Time after which a browser that was started is quiet.
BROWSER_STARTS_S = 3.0
# What a screen says of the loop before the summary begins.
ALERT = re.compile("deadline|missed")
# Bars of the loop's alarm: share of the ticks of 5 s, and gap in ms.
ALARM_SHARE, ALARM_GAP_MS = 0.01, 50.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """One run: share of missed ticks, cost of a tick in µs, and processor time over 15 s."""

    missed: float
    p50_us: float
    p99_us: float
    gap_ms: float
    alerts: int
    load: float


@contextmanager
def browser() -> Iterator[Callable[[str], None]]:
    """Run a browser of its own; yield a function that opens a page in it.

    It runs before the demo does, as that of a person who opens the demo's address.
    """
    if BROWSER is None:
        raise FileNotFoundError("chromium is not installed: run with CALM_PAGE=no")
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder:
        command = (BROWSER, *QUIET, f"--user-data-dir={folder}", "--remote-debugging-port=0")
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        try:
            port_file = Path(folder, "DevToolsActivePort")
            while not port_file.exists() or not port_file.read_text(encoding="ascii"):
                time.sleep(0.1)
            port = port_file.read_text(encoding="ascii").split()[0]
            time.sleep(BROWSER_STARTS_S)

            def visit(url: str) -> None:
                request = urllib.request.Request(
                    f"http://127.0.0.1:{port}/json/new?{url}", method="PUT"
                )
                urllib.request.urlopen(request, timeout=30).close()

            yield visit
        finally:
            os.killpg(process.pid, 15)
            process.wait()
            # Its children end after it, and still write.
            time.sleep(1)


def run(checkout: Path, with_page: bool) -> Outcome:
    """Run a checkout's demo once."""
    with tempfile.TemporaryDirectory(prefix="telepulse-") as folder, ExitStack() as stack:
        visit = stack.enter_context(browser()) if with_page else None
        summary = Path(folder, "summary.json")
        command = [sys.executable, "-m", "telepulse", "demo", "--json", str(summary)]
        command += [] if with_page else ["--no-ui"]
        environment = os.environ | {"PYTHONPATH": str(checkout), "PYTHONUNBUFFERED": "1"}
        began_s = _processor_s()
        process = stack.enter_context(
            subprocess.Popen(
                command,
                cwd=folder,
                env=environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )
        )
        assert process.stdout is not None
        lines: list[str] = []
        while visit is not None and (url := re.search(r"http://\S+", "".join(lines))) is None:
            lines.append(process.stdout.readline())
            if not lines[-1]:
                raise RuntimeError(f"no page: {''.join(lines)}")
        if visit is not None and url is not None:
            visit(url[0])
        lines += process.stdout.readlines()
        if process.wait():
            raise RuntimeError(f"the demo ended with {process.returncode}: {''.join(lines)}")
        load = (_processor_s() - began_s) / 15
        return _outcome(json.loads(summary.read_text(encoding="utf-8"))["loop"], lines, load)


def _outcome(loop: dict[str, Any], lines: list[str], load: float) -> Outcome:
    title = next((n for n, line in enumerate(lines) if line.startswith("demo of")), len(lines))
    said = sum(bool(ALERT.search(line)) for line in lines[:title])
    worst = loop["worst_5s"]
    alarmed = worst["missed"] > ALARM_SHARE or worst["gap_ms"] > ALARM_GAP_MS
    ticks = loop["ticks"] + loop["deadline_misses"]
    return Outcome(
        loop["deadline_misses"] / ticks,
        loop["tick_us"]["p50"],
        loop["tick_us"]["p99"],
        worst["gap_ms"],
        max(said, int(alarmed)),
        load,
    )


def _processor_s() -> float:
    times = os.times()
    return times.children_user + times.children_system


def main() -> None:
    """Print the table."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    states = {"now": HERE}
    if before := os.environ.get("CALM_BEFORE"):
        states = {"before": Path(before).resolve(), **states}
    kinds = (True, False) if os.environ.get("CALM_PAGE") != "no" else (False,)
    outcomes: dict[tuple[bool, str], list[Outcome]] = {}
    for _ in range(RUNS):
        for with_page in kinds:
            for state, checkout in states.items():
                outcomes.setdefault((with_page, state), []).append(run(checkout, with_page))
    rows = [_row(*key, found) for key, found in sorted(outcomes.items(), reverse=True)]
    columns = (
        *("demo", "state", "runs", "with an alert", "missed, %", "at most"),
        *("tick p50, µs", "p99", "longest gap, ms", "load, %"),
    )
    show("The default demo on two cores: medians of the runs, and the worst", columns, rows)


def _row(with_page: bool, state: str, found: list[Outcome]) -> tuple[str, ...]:
    def median(key: str) -> float:
        return float(statistics.median(getattr(each, key) for each in found))

    return (
        "page in a browser" if with_page else "--no-ui",
        state,
        str(len(found)),
        str(sum(each.alerts > 0 for each in found)),
        f"{100 * median('missed'):.3f}",
        f"{100 * max(each.missed for each in found):.3f}",
        f"{median('p50_us'):.0f}",
        f"{median('p99_us'):.0f}",
        f"{max(each.gap_ms for each in found):.0f}",
        f"{100 * median('load'):.0f}",
    )
