"""Curves and scores of the page for the last seconds. Pure: no browser, no clock."""

import math
from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from display_node.scoring.beat_quality import GOOD
from display_node.scoring.error_sums import rms
from display_node.scoring.heart_rate import heart_rate_per_min
from display_node.scoring.tracking_error import MAX_GAP_NS, SPAN_NS, compared_forces_n, jnd_n
from telepulse.view.depth import depth_columns
from telepulse.view.live import DELAY_NS, FELT_N, TARGET_N, ContactorState, LiveState
from telepulse.view.plots import FINGERS, PLOTS, PRESSED, UNPRESSED, PagePlot
from telepulse.view.tables import Floats, TableSlice, Times, thin

SECOND_NS = 1_000_000_000
# Points of a curve: for ten seconds at 1 kHz the least and the greatest value of each 16 ms.
POINTS = 1_280
HEART_NS, HEART_APART_NS = 6 * SECOND_NS, SECOND_NS // 100
# A longer gap interrupts a curve. Statuses come each 0.4 s; beats are at most 2.5 s apart.
STATUS_GAP_NS, BEAT_GAP_NS = SECOND_NS, 3 * SECOND_NS
# Approximate number of steps of a plot's axis.
STEPS = 4
# Beyond the values, as a share of them: a line at the end of an axis would be half cut.
HEADROOM = 0.05
# Of a step of an axis.
BEYOND = 0.01
# A pulse has a beat in this time.
PEAK_NS = 2 * SECOND_NS
ALL_GROUPS = frozenset(plot.group for plot in PLOTS)
Columns = dict[str, Floats]


class Scores(NamedTuple):
    """Scores of a contactor over the window; None if there is none yet.

    aligned_n, in_phase_n: RMS errors. within_jnd: share of the time judged with an error below the
    just noticeable difference jnd_n. judged: share of the window that could be judged.
    """

    aligned_n: float | None
    in_phase_n: float | None
    within_jnd: float | None
    jnd_n: float | None
    judged: float | None


class WindowScores(NamedTuple):
    """Scores over a window: of the contactor of the number `chosen`, and of each in `all_scores`.

    felt_n, target_n: greatest force in the last `PEAK_NS`; NaN while the pulse is not felt.
    """

    window_s: float
    chosen: int
    scores: Scores
    all_scores: tuple[Scores, ...]
    heart_rate_per_min: float | None
    felt_n: float
    target_n: float


class WindowData(NamedTuple):
    """Curves of a window. columns: times in s before now and values, by curve; limits: by axis.

    columns: of the plots that were asked for, and of the chosen contactor. fingers: the felt force
    of each of several contactors. jnd_n: just noticeable difference, where the plot of the error
    was asked for. force_n: limits of the axes of hold-down. empty: ids of the plots without a
    value. events: time in s before now, kind and text of each in the window.
    """

    window_s: float
    columns: dict[str, Columns]
    limits: dict[str, tuple[float, float]]
    fingers: tuple[Columns, ...]
    jnd_n: float | None
    force_n: tuple[float, float]
    empty: tuple[str, ...]
    events: tuple[tuple[float, str, str], ...]


def hidden_plots(live: LiveState) -> list[str]:
    """Return the ids of the plots that do not apply to this display."""
    kinds = {PRESSED: live.depth.pressed, UNPRESSED: not live.pressing}
    return [plot.id for plot in PLOTS if not kinds.get(plot.only, True)]


def window_scores(live: LiveState, window_ns: int, chosen: int = 0) -> WindowScores:
    """Return the scores of the last `window_ns`; chosen: number of a contactor."""
    contactor = live.contactor(chosen)
    all_scores = tuple(_scores(live, each, window_ns) for each in live.contactors)
    newest = contactor.ticks.since(live.now_ns - PEAK_NS).values
    felt_n = target_n = math.nan
    if len(newest) and not math.isnan(newest[-1, DELAY_NS]):
        # NaN counts as no force.
        felt_n, target_n = np.fmax.reduce(newest[:, [FELT_N, TARGET_N]])
    chosen = live.contactors.index(contactor)
    return WindowScores(
        *(window_ns / SECOND_NS, chosen, all_scores[chosen], all_scores),
        *(_heart_rate(live, contactor), float(felt_n), float(target_n)),
    )


def window_data(
    live: LiveState, window_ns: int, chosen: int = 0, groups: Collection[str] = ALL_GROUPS
) -> WindowData:
    """Return the curves of the last `window_ns` in the plots of some groups.

    chosen: number of a contactor.
    """
    begin_ns = live.now_ns - window_ns
    contactor = live.contactor(chosen)
    plots = [plot for plot in PLOTS if plot.group in groups]
    wanted = {curve.name for plot in plots for curve in plot.curves}
    ticks, wrist, beats, delays, statuses, held = (
        table.since(begin_ns)
        for table in (
            *(contactor.ticks, contactor.wrist, contactor.beats),
            *(live.delays, live.statuses, live.depth.samples),
        )
    )
    foot_n, height_n, quality = beats.values.T
    felt_n, delay_ns, predictor_error_n, target_n = ticks.values.T
    offset_ms, uncertainty_ms, lost, late, *_, press_n = statuses.values.T
    # Two hosts' clocks may be days apart: the change of their offset matters.
    moved_ms = offset_ms - offset_ms[-1] if len(offset_ms) else offset_ms
    aligned_n, in_phase_n, jnd_n = felt_n, felt_n, None
    if "aligned" in wanted:
        aligned_n, in_phase_n, jnd_n = _errors(live, contactor, window_ns)
    curves: dict[str, tuple[TableSlice, Floats]] = {
        "wrist": (wrist, wrist.values[:, 0] * 1e3),
        "onset": (beats, np.where(quality < GOOD, math.nan, foot_n) * 1e3),
        "doubtful": (beats, np.where(quality < GOOD, foot_n, math.nan) * 1e3),
        "height": (beats, height_n * 1e3),
        "finger": (ticks, felt_n * 1e3),
        "target": (ticks, target_n * 1e3),
        "one_way": (delays, delays.values[:, 0]),
        # The status' clock offset may put an E of 0 a little below 0.
        "playout": (ticks, np.maximum(delay_ns, 0) * 1e-6),
        "predictor": (ticks, predictor_error_n * 1e3),
        "offset": (statuses, moved_ms),
        "offset_low": (statuses, moved_ms - uncertainty_ms),
        "offset_high": (statuses, moved_ms + uncertainty_ms),
        "lost": (statuses, lost),
        "late": (statuses, late),
        "in_phase": (ticks, in_phase_n * 1e3),
        "aligned": (ticks, aligned_n * 1e3),
        "hold_down": (held, held.values[:, 0]),
        "finger_press": (statuses, press_n),
    }
    columns = {}
    for name in wanted & curves.keys():
        rows, values = curves[name]
        gap_ns = BEAT_GAP_NS if rows is beats else STATUS_GAP_NS if rows is statuses else MAX_GAP_NS
        columns[name] = _thinned(live, rows, values, gap_ns)
    by_depth = depth_columns(live.depth) if "depth_now" in wanted else {}
    columns |= {name: {"t": t, "y": y} for name, (t, y) in by_depth.items()}
    forces_n = np.concatenate([(0.0, 0.1), *(t for t, _ in by_depth.values())])
    fingers: tuple[Columns, ...] = ()
    if len(live.contactors) > 1:
        tables = (each.ticks.since(begin_ns) for each in live.contactors)
        fingers = tuple(
            _thinned(live, rows, rows.values[:, FELT_N] * 1e3, MAX_GAP_NS) for rows in tables
        )
    drawn = {plot.id: [columns[curve.name] for curve in plot.curves] for plot in plots}
    drawn[FINGERS.id] = list(fingers)
    return WindowData(
        window_ns / SECOND_NS,
        columns,
        _limits(plots, drawn, jnd_n),
        fingers,
        jnd_n,
        nice(forces_n),
        tuple(id for id, each in drawn.items() if not any(np.isfinite(y["y"]).any() for y in each)),
        tuple(
            ((t_ns - live.now_ns) * 1e-9, kind, text)
            for t_ns, kind, text in live.events
            if begin_ns < t_ns <= live.now_ns
        ),
    )


def _thinned(live: LiveState, rows: TableSlice, values: Floats, gap_ns: int) -> Columns:
    """Return a curve of values at the times of rows, in s before now."""
    t_ns, y = thin(rows.first, rows.t_ns, values, POINTS, gap_ns)
    return {"t": (t_ns - live.now_ns).astype(np.float64) * 1e-9, "y": y}


def _errors(
    live: LiveState, contactor: ContactorState, window_ns: int
) -> tuple[Floats, Floats, float | None]:
    """Return a contactor's errors at each tick, aligned and in phase, and the JND, all in N.

    NaN where the pulse of that instant has not arrived, or is not felt at full strength; None where
    the just noticeable difference is unknown.
    """
    begin_ns, age_ns = live.now_ns - window_ns, contactor.playing.get("film_age_ns", 0)
    ticks = contactor.ticks.since(begin_ns)
    felt_n, delay_ns = ticks.values[:, [FELT_N, DELAY_NS]].T
    instant_ns: Times = ticks.t_ns - np.nan_to_num(delay_ns).astype(np.int64)
    # The pulse of the ticks may be older than they are by a delay longer than the window.
    wrist = contactor.wrist.since(int(instant_ns.min(initial=begin_ns)) - age_ns - SPAN_NS)
    # The felt force contains the finger's own press, which the wrist's does not.
    if live.pressing or not contactor.playing or not len(wrist.t_ns):
        nothing = np.full(len(ticks.t_ns), math.nan)
        return nothing, nothing, None
    pulse_n = contactor.playing["force_ratio"] * wrist.values[:, 0]
    felt_n = np.where(np.isnan(delay_ns), math.nan, felt_n)
    played_n, present_n = compared_forces_n(ticks.t_ns, instant_ns, wrist.t_ns, pulse_n, age_ns)
    lately_n = pulse_n[wrist.t_ns > wrist.t_ns[-1] - SPAN_NS]
    return felt_n - played_n, felt_n - present_n, jnd_n(lately_n)


def _scores(live: LiveState, contactor: ContactorState, window_ns: int) -> Scores:
    """Return the scores of a contactor's errors in the window."""
    aligned_n, in_phase_n, jnd_n = _errors(live, contactor, window_ns)
    known_n = aligned_n[~np.isnan(aligned_n)]
    within = float(np.mean(np.abs(known_n) < jnd_n)) if jnd_n and len(known_n) else None
    begin_ns = live.now_ns - window_ns
    judged = _judged(contactor.ticks.since(begin_ns), len(known_n), begin_ns, live.now_ns)
    return Scores(rms(aligned_n), rms(in_phase_n), within, jnd_n, judged)


def _judged(ticks: TableSlice, known: int, begin_ns: int, now_ns: int) -> float | None:
    """Return the share of the window's time, or of a shorter telemetry's, that could be judged."""
    tick_ns = float(np.median(np.diff(ticks.t_ns))) if len(ticks.t_ns) > 1 else 0.0
    if not tick_ns:
        return None
    whole_ns = now_ns - (begin_ns if ticks.first else int(ticks.t_ns[0])) + tick_ns
    return min(1.0, float(known) * tick_ns / whole_ns)


def _heart_rate(live: LiveState, contactor: ContactorState) -> float | None:
    """Return the heart rate of the pulse that is felt at full strength now, or None."""
    ticks = contactor.ticks.since(live.now_ns - HEART_NS)
    if len(ticks.t_ns) < 2:
        return None
    tick_ns = float(np.median(np.diff(ticks.t_ns)))
    thin_by = max(1, round(HEART_APART_NS / max(tick_ns, 1.0)))
    # Every `thin_by`-th tick, including the newest, which shows whether a pulse is felt now.
    newest = slice((len(ticks.t_ns) - 1) % thin_by, None, thin_by)
    felt_n, delay_ns = ticks.values[:, [FELT_N, DELAY_NS]].T
    felt_n = np.where(np.isnan(delay_ns), math.nan, felt_n)
    t_s = (ticks.t_ns[newest] - live.now_ns).astype(np.float64) * 1e-9
    return heart_rate_per_min(t_s, felt_n[newest])


def _limits(
    plots: list[PagePlot], drawn: dict[str, list[Columns]], jnd_n: float | None
) -> dict[str, tuple[float, float]]:
    band_mn = 1.25e3 * (jnd_n or 0.0)
    limits = {}
    for plot in (*plots, FINGERS):
        band = (-band_mn, band_mn) if plot.id == "error" else ()
        room = (1 + HEADROOM) * np.concatenate([(), *(each["y"] for each in drawn[plot.id])])
        limits[plot.id] = nice(np.concatenate([room, plot.least, band]))
    return limits


def nice(values: Floats) -> tuple[float, float]:
    """Return round limits around values, which seldom change; not all values may be NaN.

    A value may be beyond a limit by less than a pixel: one a little below 0 needs no further step.
    """
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    rough = (high - low) / STEPS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * digit for digit in (1, 2, 5, 10) if power * digit >= rough)
    return step * math.floor(low / step + BEYOND), step * math.ceil(high / step - BEYOND)
