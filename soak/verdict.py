"""The checks of a soak: each finding beside its bar."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from soak.accounts import Reckoning
from soak.core_time import NONE_EXCUSED, Excused
from soak.felt import Bounds
from soak.slope import slope

MEGA = 1e6
HOUR_S = 3600.0
MEMORY_BAR_MB_PER_H = 6.0
MEMORY_MAX_MB = 128.0
# Of each resource: its unit, the bar of its growth in an hour, and the most.
USAGE = {
    "memory": (" MB", MEMORY_BAR_MB_PER_H, MEMORY_MAX_MB),
    "handles": ("", 12.0, 1_000.0),
    "threads": ("", 12.0, 16.0),
}
AGAIN_BAR_S = 1.0
# An undisturbed display stays felt; the host's own stalls affect the calm pair as well.
UNTOUCHED_BAR_S = 0.1
TICK_P99_TIMES, TICK_P99_MORE_US = 2.0, 100.0
CALM_MISSES = MISSES_MORE = 0.01
# If the machine causes more than this share of misses, the loop's own cannot be separated.
MOST_EXCUSED = 0.1
# One microstep per tick.
SLEW_MARGIN = 1.05
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Check:
    """A finding and its bar; ok is None where it is reported but not judged."""

    name: str
    found: str
    bar: str = ""
    ok: bool | None = None


@dataclass(frozen=True, slots=True)
class Line:
    """Samples of one process: memory in MB, descriptors, threads.

    warm: number of first samples that belong to its warm-up.
    """

    times_s: Floats
    memory: Floats
    handles: Floats
    threads: Floats
    warm: int


@dataclass(frozen=True, slots=True)
class LoopFigures:
    """A display's loop over all its processes.

    misses: missed ticks, except while it was stopped. tick_p99_us: cost of a tick, 99th percentile,
    in its longest process. excused: misses caused by the machine.
    """

    ticks: int
    misses: int
    tick_p99_us: float
    excused: Excused = NONE_EXCUSED

    def share(self, misses: int) -> float:
        """Return a number of missed ticks as a share of all."""
        return misses / max(1, self.ticks + self.misses)

    @property
    def missed(self) -> float:
        """Return the share of the ticks that the loop missed by itself."""
        return self.share(max(0, self.misses - self.excused.all))


def judge_usage(role: str, lines: Sequence[Line]) -> list[Check]:
    """Judge memory, descriptors and threads: significant growth or too high a number fails."""
    return [
        _growth(f"{name} of {role}", [(x.times_s, getattr(x, name), x.warm) for x in lines], *bars)
        for name, bars in USAGE.items()
    ]


def _growth(
    name: str, lines: Sequence[tuple[Floats, Floats, int]], unit: str, bar: float, most_bar: float
) -> Check:
    most = max((float(values.max()) for _, values, _ in lines if len(values)), default=0.0)
    found = slope([(times_s[warm:], values[warm:]) for times_s, values, warm in lines])
    limits = f"not surely above {bar:g}{unit}/h; {most_bar:g}{unit}"
    if found is None:
        text = f"most {most:.4g}{unit}; no process ran long enough for a slope"
        return Check(name, text, limits, None if most <= most_bar else False)
    low, median, high = (value * HOUR_S for value in (found.low, found.median, found.high))
    text = f"most {most:.4g}{unit}, {median:+.2f} [{low:+.2f}, {high:+.2f}]{unit}/h"
    return Check(name, text, limits, low <= bar and most <= most_bar)


def judge_recovery(again_s: Mapping[str, Sequence[float | None]]) -> list[Check]:
    """Judge the times from the end of a fault until the pulse is felt, by kind and together.

    None: it was not felt again.
    """
    checks = []
    together = {"any fault": [after_s for all_s in again_s.values() for after_s in all_s]}
    for kind, all_s in [*sorted(again_s.items()), *together.items()]:
        known = [after_s for after_s in all_s if after_s is not None]
        never = len(all_s) - len(known)
        if known:
            p50, p99, worst = (float(np.quantile(known, share)) for share in (0.5, 0.99, 1.0))
            text = f"p50 {p50:.2f} s, p99 {p99:.2f} s, worst {worst:.2f} s of {len(all_s)}"
        else:
            worst, text = 0.0, f"none of {len(all_s)}"
        text += f", {never} not felt again" if never else ""
        # A soak without a fault does not pass.
        ok = bool(known) and not never and worst <= AGAIN_BAR_S
        checks.append(Check(f"felt again: {kind}", text, f"within {AGAIN_BAR_S:g} s", ok))
    return checks


def judge_untouched(gaps_s: Sequence[float], calm_s: Sequence[float]) -> list[Check]:
    """Judge the longest time without the pulse at a display while another one had a fault."""
    control_s, worst_s = max(calm_s, default=0.0), max(gaps_s, default=0.0)
    bar_s = max(UNTOUCHED_BAR_S, control_s)
    return [
        Check("longest gap of the calm display", f"{control_s:.3f} s"),
        Check(
            "longest gap of a display beside a fault",
            f"{worst_s:.3f} s of {len(gaps_s)}",
            f"{UNTOUCHED_BAR_S:g} s or the calm display's",
            worst_s <= bar_s,
        ),
    ]


def judge_account(role: str, reckonings: Sequence[Reckoning]) -> Check:
    """Judge whether every sample of every session is accounted for."""
    counted = sum(reckoning.counted for reckoning in reckonings)
    exact = sum(reckoning.exact for reckoning in reckonings)
    lost = sum(max(0, reckoning.off) for reckoning in reckonings)
    invented = -sum(min(0, reckoning.off) for reckoning in reckonings)
    unreported = sum(max(0, r.most - r.counted) for r in reckonings if not r.exact)
    text = (
        f"{counted} samples, {exact} of {len(reckonings)} spans exact, {lost} unaccounted,"
        f" {invented} made up; at most {unreported} sent and not received in the others"
    )
    ok = lost == invented == 0 if reckonings else None
    return Check(f"account of {role}", text, "0 and 0", ok)


def judge_safety(role: str, felt: Bounds, limit_n: float, slew_n_per_s: float) -> list[Check]:
    """Judge force and slew of the target and of the felt force."""
    if not felt.ticks:
        return [Check(f"force of {role}", "nothing was felt")]
    low_n, high_n = min(felt.target_n[0], felt.felt_n[0]), max(felt.target_n[1], felt.felt_n[1])
    slews = felt.target_slew_n_per_s, felt.felt_slew_n_per_s
    return [
        Check(
            f"force of {role}",
            f"{low_n:.3f} to {high_n:.3f} N in {felt.ticks} ticks, {felt.not_finite} no numbers",
            f"0 to {limit_n:g} N, always a number",
            low_n >= 0 and high_n <= limit_n * (1 + 1e-6) and not felt.not_finite,
        ),
        Check(
            f"slew of {role}",
            f"{slews[0]:.2f} N/s wanted, {slews[1]:.2f} N/s felt;"
            f" {felt.catching_up_n_per_s:.0f} N/s after missed ticks",
            f"{slew_n_per_s:g} N/s and {SLEW_MARGIN:g} times that",
            slews[0] <= slew_n_per_s * (1 + 1e-6) and slews[1] <= slew_n_per_s * SLEW_MARGIN,
        ),
    ]


def judge_calm_loop(calm: LoopFigures) -> list[Check]:
    """Judge the calm display's deadlines and ticks, which show the host's own effect on a node."""
    return [
        Check(
            "deadlines of calm display",
            _missed(calm),
            f"{CALM_MISSES:.0%} of its own",
            _within(calm, CALM_MISSES),
        ),
        Check("tick of calm display", f"p99 {calm.tick_p99_us:.0f} µs"),
    ]


def judge_loop(role: str, figures: LoopFigures, calm: LoopFigures) -> list[Check]:
    """Judge deadline misses and the cost of a tick, beside those of the calm display."""
    p99_bar_us = TICK_P99_TIMES * calm.tick_p99_us + TICK_P99_MORE_US
    missed_bar = calm.missed + MISSES_MORE
    return [
        Check(
            f"deadlines of {role}",
            _missed(figures),
            f"{missed_bar:.3%} of its own, the calm display's and {MISSES_MORE:.0%}",
            _within(figures, missed_bar),
        ),
        Check(
            f"tick of {role}",
            f"p99 {figures.tick_p99_us:.0f} µs",
            f"{p99_bar_us:.0f} µs, {TICK_P99_TIMES:g} times the calm one's"
            f" and {TICK_P99_MORE_US:g}",
            bool(figures.ticks) and figures.tick_p99_us <= p99_bar_us,
        ),
    ]


def _within(figures: LoopFigures, bar: float) -> bool | None:
    """Return whether a loop's own misses are within a bar; None if that cannot be judged."""
    if figures.ticks and figures.share(figures.excused.all) > MOST_EXCUSED:
        return None
    return bool(figures.ticks) and figures.missed <= bar


def _missed(figures: LoopFigures) -> str:
    shares = (figures.misses, figures.excused.waited, figures.excused.stolen)
    missed, waited, stolen = (figures.share(count) for count in shares)
    return (
        f"{missed:.3%} of {figures.ticks + figures.misses} ticks missed: {waited:.3%} while it"
        f" waited for a processor, {stolen:.3%} stolen, {figures.missed:.3%} of its own"
        + ("; not judged: the machine was too busy" if _within(figures, 1.0) is None else "")
    )


def judge_none(name: str, found: Sequence[str]) -> Check:
    """Judge a list that must be empty."""
    return Check(name, "; ".join(found) or "none", "none", not found)
