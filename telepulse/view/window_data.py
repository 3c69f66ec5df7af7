"""Curves and scores of the page for the last seconds. Pure: no browser, no clock."""

import math
from typing import NamedTuple

import numpy as np

from display_node.scoring.beat_quality import GOOD
from display_node.scoring.heart_rate import heart_rate_per_min
from display_node.scoring.tracking_error import JND, MAX_GAP_NS, SPAN_NS, interpolate
from telepulse.view.depth import depth_columns
from telepulse.view.live import ContactorState, LiveState
from telepulse.view.plots import FINGERS, PLOTS, PRESSED, UNPRESSED
from telepulse.view.tables import Floats, TableSlice, Times, thin

SECOND_NS = 1_000_000_000
# Points of a curve: for ten seconds at 1 kHz the least and the greatest value of each 16 ms.
POINTS = 1_280
HEART_NS, HEART_APART_NS = 6 * SECOND_NS, SECOND_NS // 100
# A longer gap interrupts a curve. Statuses come five times a second; beats are at most 2.5 s apart.
STATUS_GAP_NS, BEAT_GAP_NS = SECOND_NS, 3 * SECOND_NS
# Approximate number of steps of a plot's axis.
STEPS = 4
# Beyond the values, as a share of them: a line at the end of an axis would be half cut.
HEADROOM = 0.05
# Of a step of an axis.
BEYOND = 0.01
Columns = dict[str, Floats]


class WindowScores(NamedTuple):
    """Scores over the window; None if there is none yet.

    in_phase_n, aligned_n: RMS errors. within_jnd: share of the time judged with an error below the
    just noticeable difference jnd_n. judged: share of the window that could be judged.
    """

    in_phase_n: float | None
    aligned_n: float | None
    within_jnd: float | None
    jnd_n: float | None
    judged: float | None


class WindowData(NamedTuple):
    """Data of a window. columns: times in s before now and values, by curve; limits: by axis.

    columns, scores and heart rate are those of the contactor of the number `chosen`. fingers: the
    felt force of each of several contactors; all_scores: the scores of each contactor. force_n:
    limits of the axes of hold-down. hidden: ids of the plots that do not apply; empty: of those
    without a value. events: time in s before now, kind and text of each in the window.
    """

    window_s: float
    columns: dict[str, Columns]
    limits: dict[str, tuple[float, float]]
    scores: WindowScores
    heart_rate_per_min: float | None
    chosen: int
    fingers: tuple[Columns, ...]
    all_scores: tuple[WindowScores, ...]
    force_n: tuple[float, float]
    hidden: tuple[str, ...]
    empty: tuple[str, ...]
    events: tuple[tuple[float, str, str], ...]


def window_data(live: LiveState, window_ns: int, chosen: int = 0) -> WindowData:
    """Return the curves and scores of the last `window_ns`; chosen: number of a contactor."""
    begin_ns = live.now_ns - window_ns
    contactor = live.contactor(chosen)
    chosen = live.contactors.index(contactor)
    ticks, wrist, beats, delays, statuses = (
        table.since(begin_ns)
        for table in (
            *(contactor.ticks, contactor.wrist, contactor.beats),
            *(live.delays, live.statuses),
        )
    )
    foot_n, height_n, quality = beats.values.T
    felt_n, delay_ns, predictor_error_n = ticks.values.T
    wrist_n = wrist.values[:, 0]
    finger_per_n, ratio = (
        contactor.playing.get(name, math.nan) for name in ("strain_per_newton", "force_ratio")
    )
    offset_ms, uncertainty_ms, skew_ppm, lost, late, *_, press_n = statuses.values.T
    held = live.depth.since(begin_ns)
    # Two hosts' clocks may be days apart: the change of their offset matters.
    moved_ms = offset_ms - offset_ms[-1] if len(offset_ms) else offset_ms
    errors = [_errors(live, each, window_ns) for each in live.contactors]
    pairs = zip(live.contactors, errors, strict=True)
    all_scores = tuple(_scores(live, each, found, window_ns) for each, found in pairs)
    in_phase_n, aligned_n, jnd_n = errors[chosen]
    curves: dict[str, tuple[TableSlice, Floats]] = {
        "wrist": (wrist, wrist_n * 1e3),
        "onset": (beats, np.where(quality < GOOD, math.nan, foot_n) * 1e3),
        "doubtful": (beats, np.where(quality < GOOD, foot_n, math.nan) * 1e3),
        "height": (beats, height_n * 1e3),
        "finger": (ticks, felt_n * 1e3),
        # Compressive strain in millionths.
        "wrist_strain": (wrist, wrist_n * (-1e6 * finger_per_n * ratio)),
        "finger_strain": (ticks, felt_n * (-1e6 * finger_per_n)),
        "one_way": (delays, delays.values[:, 0]),
        # The status' clock offset may put an E of 0 a little below 0.
        "playout": (ticks, np.maximum(delay_ns, 0) * 1e-6),
        "predictor": (ticks, predictor_error_n * 1e3),
        "offset": (statuses, moved_ms),
        "offset_low": (statuses, moved_ms - uncertainty_ms),
        "offset_high": (statuses, moved_ms + uncertainty_ms),
        "skew": (statuses, skew_ppm),
        "lost": (statuses, lost),
        "late": (statuses, late),
        "in_phase": (ticks, in_phase_n * 1e3),
        "aligned": (ticks, aligned_n * 1e3),
        "hold_down": (held, held.values[:, 0]),
        "finger_press": (statuses, press_n),
    }
    columns = {}
    for name, (rows, values) in curves.items():
        gap_ns = BEAT_GAP_NS if rows is beats else STATUS_GAP_NS if rows is statuses else MAX_GAP_NS
        columns[name] = _thinned(live, rows, values, gap_ns)
    by_depth = depth_columns(live.depth)
    columns |= {name: {"t": t, "y": y} for name, (t, y) in by_depth.items()}
    forces_n = np.concatenate([(0.0, 0.1), *(t for t, _ in by_depth.values())])
    kinds = {PRESSED: live.depth.pressed, UNPRESSED: not live.pressing}
    fingers: tuple[Columns, ...] = ()
    if len(live.contactors) > 1:
        tables = (each.ticks.since(begin_ns) for each in live.contactors)
        fingers = tuple(
            _thinned(live, rows, rows.values[:, 0] * 1e3, MAX_GAP_NS) for rows in tables
        )
    return WindowData(
        window_ns / SECOND_NS,
        columns,
        _limits(columns, fingers, jnd_n),
        all_scores[chosen],
        _heart_rate(live, contactor),
        chosen,
        fingers,
        all_scores,
        nice(forces_n),
        tuple(plot.id for plot in PLOTS if not kinds.get(plot.only, True)),
        _empty(columns, fingers),
        tuple(
            ((t_ns - live.now_ns) * 1e-9, kind, text)
            for t_ns, kind, text in live.events
            if begin_ns < t_ns <= live.now_ns
        ),
    )


def _empty(columns: dict[str, Columns], fingers: tuple[Columns, ...]) -> tuple[str, ...]:
    """Return the ids of the plots of which no curve has a value."""
    curves = {plot.id: [columns[curve.name] for curve in plot.curves] for plot in PLOTS}
    curves[FINGERS.id] = list(fingers)
    return tuple(
        id for id, each in curves.items() if not any(np.isfinite(one["y"]).any() for one in each)
    )


def _thinned(live: LiveState, rows: TableSlice, values: Floats, gap_ns: int) -> Columns:
    """Return a curve of values at the times of rows, in s before now."""
    t_ns, y = thin(rows.first, rows.t_ns, values, POINTS, gap_ns)
    return {"t": (t_ns - live.now_ns).astype(np.float64) * 1e-9, "y": y}


class WindowErrors(NamedTuple):
    """Errors of a contactor's felt force at each of its ticks, in phase and aligned, in N.

    NaN where the pulse of that instant has not arrived, or is not felt at full strength. jnd_n: the
    just noticeable difference; None where it is unknown.
    """

    in_phase_n: Floats
    aligned_n: Floats
    jnd_n: float | None


def _errors(live: LiveState, contactor: ContactorState, window_ns: int) -> WindowErrors:
    """Return the errors of a contactor in the window."""
    ticks = contactor.ticks.since(live.now_ns - window_ns)
    wrist = contactor.wrist.since(live.now_ns - window_ns - SPAN_NS)
    # The felt force contains the finger's own press, which the wrist's does not.
    if live.pressing or not contactor.playing or not len(wrist.t_ns):
        nothing = np.full(len(ticks.t_ns), math.nan)
        return WindowErrors(nothing, nothing, None)
    right_n = contactor.playing["force_ratio"] * wrist.values[:, 0]
    felt_n, delay_ns, _ = ticks.values.T
    scored = ~np.isnan(delay_ns)
    played_ns: Times = ticks.t_ns - np.where(scored, delay_ns, 0).astype(np.int64)
    in_phase_n, aligned_n = (
        np.where(scored, felt_n - interpolate(at_ns, wrist.t_ns, right_n), math.nan)
        for at_ns in (ticks.t_ns, played_ns)
    )
    lately = right_n[wrist.t_ns > wrist.t_ns[-1] - SPAN_NS]
    return WindowErrors(in_phase_n, aligned_n, JND * float(np.ptp(lately)))


def _scores(
    live: LiveState, contactor: ContactorState, errors: WindowErrors, window_ns: int
) -> WindowScores:
    """Return the scores of a contactor's errors in the window."""
    in_phase_n, aligned_n, jnd_n = errors
    known_n = aligned_n[~np.isnan(aligned_n)]
    within = float(np.mean(np.abs(known_n) < jnd_n)) if jnd_n and len(known_n) else None
    begin_ns = live.now_ns - window_ns
    judged = _judged(contactor.ticks.since(begin_ns), len(known_n), begin_ns, live.now_ns)
    return WindowScores(_rms(in_phase_n), _rms(aligned_n), within, jnd_n, judged)


def _rms(error_n: Floats) -> float | None:
    known_n = error_n[~np.isnan(error_n)]
    return math.sqrt(float(np.mean(known_n**2))) if len(known_n) else None


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
    felt_n, delay_ns, _ = ticks.values.T
    felt_n = np.where(np.isnan(delay_ns), math.nan, felt_n)
    t_s = (ticks.t_ns[newest] - live.now_ns).astype(np.float64) * 1e-9
    return heart_rate_per_min(t_s, felt_n[newest])


def _limits(
    columns: dict[str, Columns], fingers: tuple[Columns, ...], jnd_n: float | None
) -> dict[str, tuple[float, float]]:
    band_mn = 1.25e3 * (jnd_n or 0.0)
    limits = {}
    for plot in PLOTS:
        curves = [columns[curve.name]["y"] for curve in plot.curves]
        band = (-band_mn, band_mn) if plot.id == "error" else ()
        room = (1 + HEADROOM) * np.concatenate(curves)
        limits[plot.id] = nice(np.concatenate([room, plot.least, band]))
    room = (1 + HEADROOM) * np.concatenate([(0.0,), *(each["y"] for each in fingers)])
    limits[FINGERS.id] = nice(np.concatenate([FINGERS.least, room]))
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
