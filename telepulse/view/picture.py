"""Curves and scores of the page at one instant. Pure: no browser, no clock."""

import math
from typing import NamedTuple

import numpy as np

from display_node.scoring.heart_rate import heart_rate_per_min
from display_node.scoring.tracking_error import JND, MAX_GAP_NS, SPAN_NS, interpolate
from telepulse.view.live import Floats, LiveState, TableSlice, Times, thin

SECOND_NS = 1_000_000_000
# Ten seconds at 1 kHz: of each 16 ms the least and the greatest.
POINTS = 1_280
HEART_NS, HEART_APART_NS = 6 * SECOND_NS, SECOND_NS // 100
# Statuses come five times a second.
STATUS_GAP_NS = SECOND_NS
# Of a plot's axis, about.
STEPS = 4
Columns = dict[str, Floats]


class PictureScores(NamedTuple):
    """Scores over the window, None where there is none yet.

    in_phase_n, aligned_n: RMS errors. within_jnd: share of the time judged with an error below the
    just noticeable difference jnd_n. judged: share of the window that could be judged.
    """

    in_phase_n: float | None
    aligned_n: float | None
    within_jnd: float | None
    jnd_n: float | None
    judged: float | None


class Picture(NamedTuple):
    """Curves of a window; columns: t in s before now and values of each; limits: of each axis."""

    window_s: float

    columns: dict[str, Columns]
    limits: dict[str, tuple[float, float]]
    scores: PictureScores
    heart_rate_per_min: float | None


def picture(live: LiveState, window_ns: int) -> Picture:
    """Return the curves and scores of the last `window_ns`."""
    begin_ns = live.now_ns - window_ns
    ticks, wrist = live.ticks.since(begin_ns), live.wrist.since(begin_ns)
    curve = _Curves(live.now_ns)
    felt_n, wrist_n = ticks.values[:, 0], wrist.values[:, 0]
    columns = {
        "wrist": curve(wrist, wrist_n * 1e3),
        "finger": curve(ticks, felt_n * 1e3),
        "wrist_strain": curve(wrist, _compression(wrist_n, live.wrist_strain_per_newton)),
        "finger_strain": curve(ticks, _compression(felt_n, live.finger_strain_per_newton)),
        "one_way": curve(delays := live.delays.since(begin_ns), delays.values[:, 0]),
        "playout": curve(ticks, ticks.values[:, 2] * 1e-6),
        "predictor": curve(ticks, ticks.values[:, 3] * 1e3),
    }
    statuses = live.statuses.since(begin_ns)
    offset_ms, uncertainty_ms, skew_ppm, lost, late = statuses.values[:, :5].T
    # Two hosts' clocks may be days apart: the change of their offset matters.
    moved_ms = offset_ms - offset_ms[-1] if len(offset_ms) else offset_ms
    columns |= {
        "offset": curve(statuses, moved_ms, STATUS_GAP_NS),
        "offset_low": curve(statuses, moved_ms - uncertainty_ms, STATUS_GAP_NS),
        "offset_high": curve(statuses, moved_ms + uncertainty_ms, STATUS_GAP_NS),
        "skew": curve(statuses, skew_ppm, STATUS_GAP_NS),
        "lost": curve(statuses, lost, STATUS_GAP_NS),
        "late": curve(statuses, late, STATUS_GAP_NS),
    }
    in_phase_n, aligned_n, jnd_n = _errors(live, ticks, window_ns)
    columns |= {
        "in_phase": curve(ticks, in_phase_n * 1e3),
        "aligned": curve(ticks, aligned_n * 1e3),
    }
    within, judged = _within(aligned_n, jnd_n), _judged(ticks, aligned_n, begin_ns, live.now_ns)
    scores = PictureScores(_rms(in_phase_n), _rms(aligned_n), within, jnd_n, judged)
    return Picture(
        window_ns / SECOND_NS, columns, _limits(columns, jnd_n), scores, _heart_rate(live)
    )


class _Curves:
    """Maker of thinned curves over seconds before now."""

    def __init__(self, now_ns: int) -> None:
        self._now_ns = now_ns

    def __call__(self, rows: TableSlice, values: Floats, gap_ns: int = MAX_GAP_NS) -> Columns:
        t_ns, y = thin(rows.first, rows.t_ns, values, POINTS, gap_ns)
        return {"t": (t_ns - self._now_ns).astype(np.float64) * 1e-9, "y": y}


def _compression(force_n: Floats, strain_per_newton: float | None) -> Floats:
    """Return compressive strain in millionths; NaN while the layer is unknown."""
    return force_n * (math.nan if strain_per_newton is None else -1e6 * strain_per_newton)


def _errors(
    live: LiveState, ticks: TableSlice, window_ns: int
) -> tuple[Floats, Floats, float | None]:
    """Return the errors of the felt force in phase and aligned, and the JND, all in N.

    NaN where the pulse of that instant has not arrived, or is not felt at full strength.
    """
    ratio = live.force_ratio
    wrist = live.wrist.since(live.now_ns - window_ns - SPAN_NS)
    if ratio is None or not len(wrist.t_ns):
        nothing = np.full(len(ticks.t_ns), math.nan)
        return nothing, nothing, None
    right_n = ratio * wrist.values[:, 0]
    felt_n, delay_ns = ticks.values[:, 0], ticks.values[:, 2]
    scored = ~np.isnan(delay_ns)
    played_ns: Times = ticks.t_ns - np.where(scored, delay_ns, 0).astype(np.int64)
    in_phase_n, aligned_n = (
        np.where(scored, felt_n - interpolate(at_ns, wrist.t_ns, right_n), math.nan)
        for at_ns in (ticks.t_ns, played_ns)
    )
    lately = right_n[wrist.t_ns > wrist.t_ns[-1] - SPAN_NS]
    return in_phase_n, aligned_n, JND * float(np.ptp(lately))


def _rms(error_n: Floats) -> float | None:
    known = error_n[~np.isnan(error_n)]
    return math.sqrt(float(np.mean(known**2))) if len(known) else None


def _within(error_n: Floats, jnd_n: float | None) -> float | None:
    known = error_n[~np.isnan(error_n)]
    return float(np.mean(np.abs(known) < jnd_n)) if jnd_n and len(known) else None


def _judged(ticks: TableSlice, error_n: Floats, begin_ns: int, now_ns: int) -> float | None:
    """Return which share of the window could be judged: of its time, not of the ticks that came.

    With less telemetry than the window, the window is as long as the telemetry.
    """
    tick_ns = float(np.median(np.diff(ticks.t_ns))) if len(ticks.t_ns) > 1 else 0.0
    if not tick_ns:
        return None
    whole_ns = now_ns - (begin_ns if ticks.first else int(ticks.t_ns[0])) + tick_ns
    return min(1.0, float(np.count_nonzero(~np.isnan(error_n))) * tick_ns / whole_ns)


def _heart_rate(live: LiveState) -> float | None:
    """Return the heart rate of what is felt at full strength now."""
    ticks = live.ticks.since(live.now_ns - HEART_NS)
    if len(ticks.t_ns) < 2:
        return None
    tick_ns = float(np.median(np.diff(ticks.t_ns)))
    thin_by = max(1, round(HEART_APART_NS / max(tick_ns, 1.0)))
    # From the newest tick back, which shows whether a pulse is felt now.
    newest = slice((len(ticks.t_ns) - 1) % thin_by, None, thin_by)
    felt_n = np.where(np.isnan(ticks.values[:, 2]), math.nan, ticks.values[:, 0])
    t_s = (ticks.t_ns[newest] - live.now_ns).astype(np.float64) * 1e-9
    return heart_rate_per_min(t_s, felt_n[newest])


def _limits(columns: dict[str, Columns], jnd_n: float | None) -> dict[str, tuple[float, float]]:
    jnd_mn = (jnd_n or 0.0) * 1.25e3
    curves: dict[str, tuple[tuple[str, ...], tuple[float, ...]]] = {
        "force": (("wrist", "finger"), (0.0, 1.0)),
        "strain": (("wrist_strain", "finger_strain"), (0.0, 0.01)),
        "error": (("in_phase", "aligned"), (-jnd_mn, jnd_mn, -1.0, 1.0)),
        "delay": (("one_way", "playout"), (0.0, 1.0)),
        "loss": (("lost", "late"), (0.0, 1.0)),
        "offset": (("offset_low", "offset_high"), (-0.01, 0.01)),
        "skew": (("skew",), (-1.0, 1.0)),
        "predictor": (("predictor",), (0.0, 1.0)),
    }
    return {
        plot: nice(np.concatenate([*(columns[name]["y"] for name in names), least]))
        for plot, (names, least) in curves.items()
    }


def nice(values: Floats) -> tuple[float, float]:
    """Round limits around values, which change seldom while a curve moves; not all may be NaN."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    rough = (high - low) / STEPS
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(power * digit for digit in (1, 2, 5, 10) if power * digit >= rough)
    return step * math.floor(low / step), step * math.ceil(high / step)
