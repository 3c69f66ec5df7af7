"""Ticks that a display misses without metrics, with a scrape per second, and with 20 scrapers.

Runs take turns, so that a busy moment of the machine affects all equally.
"""

import re
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from http.client import HTTPException
from pathlib import Path
from subprocess import PIPE
from tempfile import TemporaryDirectory
from urllib.request import urlopen

from benchmarks.benchmark import Benchmark
from benchmarks.timing import median_quantile
from protocol.config.scene_file import find_scene
from protocol.summary.tables import Loop
from telepulse.processes import NodeProcess, free_addresses

SECONDS = 8.0
ROUNDS = 5
THREADS = 20
ENDS_WITHIN_S = 60.0
CASES = {"none served": 0, "once a second": 1, f"{THREADS} threads": THREADS}
COLUMNS = ("scraped", "scrapes a second", "p50 late µs", "p99 late µs", "missed of 1000", "ratio")


def main(benchmark: Benchmark) -> None:
    """Print the table."""
    scene = str(find_scene("radial"))
    (address,) = free_addresses(1)
    runs: dict[str, list[tuple[Loop, float]]] = {name: [] for name in CASES}
    command = ("sensing_node.cli", scene, "--bind", address, "--quiet")
    with (
        TemporaryDirectory(prefix="telepulse-") as folder,
        NodeProcess("sensing node", *command, summary=Path(folder, "s.json")),
    ):
        for _ in range(ROUNDS):
            for name, found in runs.items():
                found.append(_play(scene, address, CASES[name], Path(folder, "d.json")))
    bare = _missed(runs["none served"])
    benchmark.table(
        f"A display at 1 kHz whose metrics are scraped: medians of {ROUNDS} rounds of"
        f" {SECONDS:g} s",
        COLUMNS,
        [_row(name, found, bare) for name, found in runs.items()],
    )


def _row(name: str, found: list[tuple[Loop, float]], bare: float) -> tuple[str, ...]:
    missed = _missed(found)
    return (
        name,
        f"{statistics.median(rate for _, rate in found):.0f}",
        *(median_quantile(key, (loop.late_us for loop, _ in found)) for key in ("p50", "p99")),
        f"{missed:.1f}",
        f"{missed / bare:.2f}" if bare else "–",
    )


def _missed(found: list[tuple[Loop, float]]) -> float:
    """Return the ticks missed of 1000, median of the rounds."""
    shares = []
    for loop, _ in found:
        missed = loop.deadline_misses or 0
        shares.append(1000 * missed / max(1, missed + (loop.ticks or 0)))
    return statistics.median(shares)


def _play(scene: str, address: str, threads: int, summary: Path) -> tuple[Loop, float]:
    """Return the loop's figures of a display's run, and the rate of scrapes in Hz."""
    with NodeProcess(
        *("display node", "display_node.cli", scene, "--connect", address, "--no-screen"),
        *("--seconds", str(SECONDS), *(("--metrics", "0") if threads else ())),
        summary=summary,
        stdout=PIPE,
        stderr=PIPE,
    ) as node:
        if not threads:
            return node.await_summary(SECONDS + ENDS_WITHIN_S).loop, 0.0
        found = re.search(r"http://\S+", node.read_line(ENDS_WITHIN_S, from_stderr=True))
        assert found is not None
        with _scraping(found[0], threads) as scrapes:
            loop = node.await_summary(SECONDS + ENDS_WITHIN_S).loop
            return loop, scrapes() / SECONDS


@contextmanager
def _scraping(url: str, threads: int) -> Iterator[Callable[[], int]]:
    """Scrape in `threads` threads; yield a count of the scrapes. One alone waits 1 s after each."""
    ending, counts = threading.Event(), [0] * threads

    def scrape(number: int) -> None:
        while not ending.wait(1 if threads == 1 else 0):
            try:
                with urlopen(url, timeout=5) as answer:
                    answer.read()
            except (OSError, HTTPException):  # the server ends with the display
                time.sleep(0.1)
            else:
                counts[number] += 1

    workers = [threading.Thread(target=scrape, args=(number,)) for number in range(threads)]
    for worker in workers:
        worker.start()
    try:
        yield lambda: sum(counts)
    finally:
        ending.set()
        for worker in workers:
            worker.join()
