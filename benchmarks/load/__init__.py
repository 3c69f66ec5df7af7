"""Number of displays that one sensing node feeds at 1 kHz, their cost, and the effect of relays.

Many light displays (`many_displays.py`) share the machine with the sensing node, which would feed
more displays on a machine of its own. CPU is user and system time in % of one core; TCP's work on a
frame counts for the sender. It takes six minutes.
"""

import os
from dataclasses import replace

from benchmarks.benchmark import Benchmark
from benchmarks.load import clock, cut
from benchmarks.load.run import SECONDS, Figures, Load, run
from benchmarks.load.sensing import Stream

# A node serves as many displays as receive every frame, 99 of 100 within this time.
SERVED_MS = 5.0
SINGLE, BATCHED = Stream(batch=1), Stream(batch=5)
COUNTS = (1, 2, 5, 10, 20, 50, 75, 100, 150, 200, 250, 300, 400, 500, 600, 800, 1000)
FAILURES = 2
RELAYED = (2, 20, 50, 75)
CHANNELS = (1, 4, 16, 64)
SOME = 50
COLUMNS = ("displays", "p50 ms", "p99 ms", "lost", "loop", "ZeroMQ", "both")


def main(benchmark: Benchmark) -> None:
    """Print the tables."""
    print(f"{os.cpu_count()} cores, load average {os.getloadavg()[0]:.1f} before it begins")
    for stream in (SINGLE, BATCHED):
        show_counts(benchmark, stream)
    show_kinds(benchmark)
    show_channels(benchmark)
    show_relays(benchmark)
    clock.main(benchmark)
    cut.main(benchmark)


def show_counts(benchmark: Benchmark, stream: Stream) -> None:
    """Print runs of more and more displays, until two of them miss the bar."""
    rows: list[tuple[str, ...]] = []
    most, failures, last = 0, 0, (0, 0.0)
    for count in COUNTS:
        try:
            figures = run(Load(count, stream=stream))
        except RuntimeError as error:
            rows.append((str(count), str(error)))
            break
        further = (figures.sensing - last[1]) / (count - last[0])
        rows.append((*row(count, figures), f"{100 * further:.2f}", f"{100 * figures.displays:.0f}"))
        last = count, figures.sensing
        if within(figures):
            most, failures = count, 0
        else:
            failures += 1
        if failures == FAILURES:
            break
    benchmark.table(
        f"One sensing node at 1 kHz, {named(stream)}, {SECONDS:g} s each; CPU in % of a core, of"
        f" one more display, too; within {SERVED_MS:g} ms and nothing lost: {most} displays",
        (*COLUMNS, "one more", "their CPU"),
        rows,
    )


def show_kinds(benchmark: Benchmark) -> None:
    """Print the parts of a display's cost: data, clock, keys."""
    plain = Load(SOME, clock_ms=0, stream=BATCHED)
    kinds = {
        "frames alone": plain,
        "and clock, 20 /s": replace(plain, clock_ms=50),
        "and clock, 50 /s": replace(plain, clock_ms=20),
        "20 /s, with keys": replace(plain, clock_ms=50, keys=True),
    }
    rows = []
    for name, load in kinds.items():
        figures = run(load)
        rows.append((name, *row(SOME, figures)[1:], f"{100 * figures.sensing / SOME:.2f}"))
    benchmark.table(
        f"Cost of {SOME} displays for the sensing node, {named(BATCHED)}",
        ("with", *COLUMNS[1:], "each"),
        rows,
    )


def show_channels(benchmark: Benchmark) -> None:
    """Print runs from one channel to the most that a stream may have."""
    rows = []
    for channels in CHANNELS:
        figures = run(Load(SOME, stream=replace(BATCHED, channels=channels)))
        rows.append((str(channels), *row(SOME, figures)[1:]))
    benchmark.table(
        f"Channels, {SOME} displays, {named(BATCHED)}: 64 is the most that a stream has",
        ("channels", *COLUMNS[1:]),
        rows,
    )


def show_relays(benchmark: Benchmark) -> None:
    """Print runs with two relays side by side, on the same machine."""
    rows = []
    for count in RELAYED:
        figures = run(Load(count, relays=2, stream=SINGLE))
        rows.append((*row(count, figures), f"{50 * figures.relays:.1f}"))
    benchmark.table(
        f"Through two relays that share the machine, {named(SINGLE)}",
        (*COLUMNS, "each relay"),
        rows,
    )


def row(count: int, figures: Figures) -> tuple[str, ...]:
    """Return the figures common to all tables."""
    shares = (figures.loop, figures.zeromq, figures.sensing)
    return (
        str(count),
        f"{figures.p50_ms:.2f}",
        f"{figures.p99_ms:.2f}",
        str(figures.lost),
        *(f"{100 * share:.1f}" for share in shares),
    )


def within(figures: Figures) -> bool:
    """Return whether a run is within the bar."""
    return figures.p99_ms < SERVED_MS and figures.lost == 0


def named(stream: Stream) -> str:
    """Return a stream's frames in words."""
    return f"{'a sample' if stream.batch == 1 else f'{stream.batch} samples'} a frame"
