"""Settings by error, load and packets: in virtual time, as real processes, and on a slow host.

Settings are the tick, the predictor, the perceived delay E, the length of a frame and the number of
connections, over one link that loses packets. Real processes need root.
"""

import math
from functools import partial
from typing import TYPE_CHECKING

from benchmarks.benchmark import Benchmark
from benchmarks.cost import cpu_quota
from benchmarks.cost.runs import (
    EQUAL,
    LINK,
    NO_ERROR_N,
    QUICK,
    SLOW,
    Effort,
    Settings,
    SimulatedCost,
    late_delay_ms,
    late_errors_n,
    pareto_front,
    run_live,
    shipped,
    simulate_cost,
)
from tests.support.netem import NodesOutcome, unavailable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Windows of a run with real processes that begin from here on are judged: those before it, while
# the display joins and predictors learn, and on a slow host the part without a quota, are not.
JUDGED_FROM_S = 6.0
# Limits of what works: a tenth of the ticks missed, and the error that a finger notices, a tenth of
# the pulse's height.
MISSED, NOTICED_N = 0.1, 0.03
FRONT, SHIPPED = "front", "shipped"
NAMED = ("tick (ms)", "predictor", "E (ms)", "frame (ms)", "paths")
FELT = (*NAMED, "in phase (mN)", "aligned (mN)", "mean E (ms)", "p50 (µs)", "p99 (µs)")
MEASURED = (
    *FELT,
    "missed (%)",
    "sensing CPU (%)",
    "display CPU (%)",
    "packets/s",
    "kB/s",
)


def main(benchmark: Benchmark) -> None:
    """Simulate on all cores; then run real processes, one pair at a time."""
    effort = QUICK if benchmark.quick else Effort()
    cases = effort.combinations()
    simulated = benchmark.run(partial(simulate_cost, effort=effort), cases)
    _show_front(benchmark, dict(zip(cases, simulated, strict=True)))
    if reason := unavailable():
        print(f"Real processes left out: {reason}.")
        return
    live = {one: run_live(one, effort.live_seconds) for one in effort.variations()}
    benchmark.table(
        f"Real processes over {LINK}: the shipped settings, then each with one other value",
        MEASURED,
        [_measured(one, run, effort.live_seconds) for one, run in live.items()],
        f"Errors and E are a display's own from the {JUDGED_FROM_S:g}th second on. CPU: all threads"
        " over the stream's time. Packets and bytes: both directions, with IP headers.",
    )
    if reason := cpu_quota.unavailable():
        print(f"Slow host left out: {reason}.")
        return
    _show_slow(benchmark, effort)


def _show_front(benchmark: Benchmark, simulated: dict[Settings, SimulatedCost]) -> None:
    default, costs = shipped(), simulated.values()
    on_front = pareto_front([cost.objectives() for cost in costs])
    front = dict(zip(simulated, on_front, strict=True))
    rows, marked = [], []
    for one, cost in sorted(simulated.items(), key=lambda item: item[1].load):
        marks = [name for name, holds in ((FRONT, front[one]), (SHIPPED, one == default)) if holds]
        rows.append((*one.cells(), *_simulated(cost), ", ".join(marks)))
        marked += rows[-1:] if marks else []
    columns = (*FELT, "load (%)", "packets/s", "mark")
    note = (
        "On the front, no other is at least as good in both errors, load and packets; errors below"
        f" {NO_ERROR_N * 1e3:g} mN and differences below {100 * EQUAL:g} % count as none. Load is"
        " the processor time of nodes, link and scoring over the stream's time."
    )
    benchmark.table("All settings in virtual time", columns, rows)
    benchmark.table("The front, and what is shipped", columns, marked, note)
    benchmark.plot("front", partial(_draw, simulated=simulated, front=front))


def _simulated(cost: SimulatedCost) -> tuple[str, ...]:
    return (
        f"{cost.in_phase_n * 1e3:.2f}",
        f"{cost.aligned_n * 1e3:.2f}",
        f"{cost.delay_ms:z.1f}",
        f"{cost.p50_us:.0f}",
        f"{cost.p99_us:.0f}",
        f"{100 * cost.load:.1f}",
        f"{cost.frames_per_s:.0f}",
    )


def _measured(one: Settings, run: NodesOutcome, seconds: float) -> tuple[str, ...]:
    """Return the cells under `MEASURED`."""
    display, carried = run.display, run.carried
    errors_n, tick_us = late_errors_n(display, JUDGED_FROM_S), display.loop.tick_us
    missed = display.loop.last_5s.missed
    shares = (missed, run.sensing_cpu, run.display_cpu)
    return (
        *one.cells(),
        *(f"{error_n * 1e3:.2f}" for error_n in errors_n),
        f"{late_delay_ms(display, JUDGED_FROM_S):z.1f}",
        *(f"{time_us or math.nan:.0f}" for time_us in (tick_us.p50, tick_us.p99)),
        *("–" if share is None else f"{100 * share:.1f}" for share in shares),
        "–" if carried is None else f"{carried.packets / seconds:.0f}",
        "–" if carried is None else f"{carried.bytes / seconds / 1e3:.1f}",
    )


def _show_slow(benchmark: Benchmark, effort: Effort) -> None:
    rows = []
    for tick_ms, predictor, batch_ms in effort.slow:
        one = shipped()._replace(tick_ms=tick_ms, predictor=predictor, batch_ms=batch_ms)
        run = run_live(one, effort.live_seconds, SLOW)
        interruptions = str(run.display.interruptions.count)
        measured = _measured(one, run, effort.live_seconds)
        rows.append((*measured, interruptions, "yes" if works(run) else "no"))
    benchmark.table(
        f"Each node with {100 * SLOW:g} % of a core, from the fourth second on",
        (*MEASURED, "interruptions", "works"),
        rows,
        f"By a quota of cgroups: 1 ms in every {1 / SLOW:g} ms. Works: at the end fewer than"
        f" {100 * MISSED:g} % of the ticks are missed, and the aligned error is below"
        f" {NOTICED_N * 1e3:g} mN.",
    )


def works(run: NodesOutcome) -> bool:
    """Return whether few ticks were missed at a run's end, and its error goes unnoticed."""
    missed = run.display.loop.last_5s.missed
    _, aligned_n = late_errors_n(run.display, JUDGED_FROM_S)
    return missed is not None and missed < MISSED and aligned_n < NOTICED_N


def _draw(
    figure: "Figure", simulated: dict[Settings, SimulatedCost], front: dict[Settings, bool]
) -> None:
    """Draw error in phase against load; those on the front have a ring."""
    axes = figure.add_subplot()
    for predictor in dict.fromkeys(one.predictor for one in simulated):
        chosen = [one for one in simulated if one.predictor == predictor]
        load, error_mn = zip(*(_place(simulated[one]) for one in chosen), strict=True)
        axes.plot(load, error_mn, "o", label=predictor)
    best = [_place(cost) for one, cost in simulated.items() if front[one]]
    axes.plot(*zip(*best, strict=True), "ko", markersize=9, fillstyle="none", label=FRONT)
    axes.annotate(SHIPPED, _place(simulated[shipped()]))
    axes.set(xscale="log", xlabel="load (% of a core)")
    axes.set(yscale="log", ylabel="error in phase (mN)")
    figure.legend(loc="outside lower center", ncols=4, fontsize="small")


def _place(cost: SimulatedCost) -> tuple[float, float]:
    return 100 * cost.load, cost.in_phase_n * 1e3
