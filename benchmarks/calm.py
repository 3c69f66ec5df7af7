"""Missed ticks, tick cost and alerts of `telepulse demo` on two cores, without priority.

Each run is one with the page open in a real browser, or one without page and screen. With
`CALM_BEFORE` set to another checkout, its demo runs in turns with this one's. Beside some of the
demos with a page runs an empty loop: what it misses, no display can avoid without a priority.
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
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.benchmark import Benchmark
from protocol.host.process import request_short_slices
from protocol.host.realtime import Pacer

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
PAGE = "page in a browser"
# Bars of the loop's alarm: share of the ticks of 5 s, and gap in ms.
ALARM_SHARE, ALARM_GAP_MS = 0.01, 50.0
# The empty loop has the tick of the default scene, and computes for about as long in each.
EMPTY_TICK_NS, EMPTY_WORK_NS, EMPTY_S = 2_000_000, 80_000, 15


@dataclass(frozen=True, slots=True)
class Outcome:
    """One run: share of missed ticks, cost of a tick in µs, and processor time over 15 s.

    worst_5s: greatest share of missed ticks in 5 s, while the pulse is felt.
    """

    missed: float
    worst_5s: float
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


def empty_loop() -> float:
    """Return the share of the ticks that an empty loop misses; it waits and computes, no more."""
    os.setsid()
    request_short_slices()
    now_ns = time.perf_counter_ns
    began_ns = now_ns()
    pacer, ticks = Pacer(EMPTY_TICK_NS, began_ns), 0
    while (present_ns := now_ns()) < began_ns + EMPTY_S * 1_000_000_000:
        if (tick := pacer.begin(present_ns)) is None:
            time.sleep((pacer.due_ns - present_ns) * 1e-9)
            continue
        ticks += tick.elapsed_ticks
        while now_ns() < present_ns + EMPTY_WORK_NS:
            pass
    return pacer.missed / ticks


def run_beside_empty_loop() -> tuple[Outcome, float]:
    """Run this checkout's demo with a page; return its outcome, and what an empty loop misses."""
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        # The process starts, and imports, before the demo does.
        pool.submit(request_short_slices).result()
        loops = []
        outcome = run(HERE, True, lambda: loops.append(pool.submit(empty_loop)))
        return outcome, loops[0].result()


def run(checkout: Path, with_page: bool, begun: Callable[[], Any] = lambda: None) -> Outcome:
    """Run a checkout's demo once; `begun` is called when its page has been opened."""
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
        begun()
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
        worst["missed"],
        loop["tick_us"]["p50"],
        loop["tick_us"]["p99"],
        worst["gap_ms"],
        max(said, int(alarmed)),
        load,
    )


def _processor_s() -> float:
    times = os.times()
    return times.children_user + times.children_system


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    states = {"now": HERE}
    if before := os.environ.get("CALM_BEFORE"):
        states = {"before": Path(before).resolve(), **states}
    kinds = (True, False) if os.environ.get("CALM_PAGE") != "no" else (False,)
    outcomes: dict[tuple[bool, str], list[Outcome]] = {}
    empty: list[float] = []
    for _ in range(RUNS):
        for with_page in kinds:
            for state, checkout in states.items():
                outcomes.setdefault((with_page, state), []).append(run(checkout, with_page))
        if True in kinds:
            beside, missed = run_beside_empty_loop()
            outcomes.setdefault((True, "now, beside an empty loop"), []).append(beside)
            empty.append(missed)
    rows = [_row(*key, found) for key, found in sorted(outcomes.items(), reverse=True)]
    if empty:
        # It has no tick of a display, and nobody is alerted.
        shares = (f"{100 * share:.3f}" for share in (statistics.median(empty), max(empty)))
        rows.append((PAGE, "an empty loop", str(len(empty)), "–", *shares, *5 * "–"))
    columns = (
        *("demo", "state", "runs", "with an alert", "missed, %", "at most", "worst 5 s"),
        *("tick p50, µs", "p99", "longest gap, ms", "load, %"),
    )
    benchmark.table(
        "The default demo on two cores: medians of the runs, and the worst", columns, rows
    )


def _row(with_page: bool, state: str, found: list[Outcome]) -> tuple[str, ...]:
    def median(key: str) -> float:
        return float(statistics.median(getattr(each, key) for each in found))

    return (
        PAGE if with_page else "--no-ui",
        state,
        str(len(found)),
        str(sum(each.alerts > 0 for each in found)),
        f"{100 * median('missed'):.3f}",
        f"{100 * max(each.missed for each in found):.3f}",
        f"{100 * max(each.worst_5s for each in found):.2f}",
        f"{median('p50_us'):.0f}",
        f"{median('p99_us'):.0f}",
        f"{max(each.gap_ms for each in found):.0f}",
        f"{100 * median('load'):.0f}",
    )
