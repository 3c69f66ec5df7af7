"""Texts of the page: the state, the figures and the alarms. Pure."""

import math
from typing import NamedTuple

import numpy as np

from display_node.scoring.beat_quality import GOOD
from display_node.telemetry.alerts import (
    SILENT_AFTER_NS,
    Alert,
    AlertKind,
    alerts,
    delay_note,
    finger_note,
    waiting_texts,
)
from protocol.config.quantities import count_text
from protocol.finger import describe_finger, finger_in
from protocol.refusals import explain_causes
from protocol.summary.fields import contactors_of
from protocol.summary.figures import Surface, figures_on
from protocol.summary.figures import figures as summary_figures
from protocol.summary.phrases import NEWTONS, SHARE, limit_texts
from protocol.summary.rows import summary_rows
from protocol.tactile import JND
from telepulse.telemetry.decoder import Fields
from telepulse.telemetry.events import CUT_AFTER_NS, REFUSALS
from telepulse.view.depth import DepthState, levels
from telepulse.view.live import DELAY_NS, FELT_N, MAX_CONTACTORS, LiveState
from telepulse.view.window_data import SECOND_NS, Scores, WindowScores

# An alarm for a single occurrence is shown for this long.
SHOWN_NS = 5 * SECOND_NS
MUCH_LOSS = 5.0
# Before the first status; also what a page shows while it loads.
ALARMS_UNKNOWN = "Alarms are unknown until a display sends its state."
# Indices of columns in `LiveState.statuses`.
LOST, LATE, REFUSED, LIMITED, READERS_REFUSED = 2, 3, 4, 5, 6
NOTHING = "–"
DELAY = "of the finger behind the wrist"
# Statuses come each 0.4 s; one that is older than this is not current.
CURRENT_NS = 1_000_000_000
# Meaning of each state.
STATES = {
    "": "no telemetry from a display yet",
    "waiting": "for the sensing node",
    "starting": "the pulse comes up",
    "playing": "the pulse is felt",
    "stale": "no samples to play",
    "ended": "the stream is over",
    "fault": "latched until the display is started again",
    "final": "the display has ended; this is its last state",
}
# The page computes these figures of the summary over its window, not since the start of the run.
_NAMES = {figure.key: figure.name for figure in summary_figures()}
ALIGNED, IN_PHASE, WITHIN = (
    f"{_NAMES[key]}, in the window"
    for key in ("force_rmse_n.aligned", "force_rmse_n.in_phase", "within_jnd")
)
# Names of the figures by their ids: those that are always seen, those of the folded groups, and the
# rows of the summary.
ALWAYS_SEEN = {
    "force": "force felt",
    "heart": "heart rate",
    "delay": "delay",
    "aligned": ALIGNED,
}
FIGURES = {
    **ALWAYS_SEEN,
    "in_phase": IN_PHASE,
    "within": WITHIN,
    "loss": "loss",
    "predictor": "predictor",
    "press": "press",
    "levels": "levels",
    **{each.row.replace(" ", "-"): each.row for each in figures_on(Surface.PAGE)},
}


class Group(NamedTuple):
    """A folded part of the page; the first of its figures with a value is seen beside the title."""

    id: str
    title: str
    figures: tuple[str, ...] = ()


_GROUPS = (
    Group("press", "Press", ("press", "levels")),
    Group(
        *("prediction", "Errors and prediction"),
        ("in_phase", "within", "predictor", "prediction", "prediction-trusted", "felt-ahead"),
    ),
    Group("pulse", "Pulse at the wrist", ("pulse", "ECG")),
    Group(
        *("link", "Link"),
        (
            *("loss", "one-way-delay", "playout-delay", "data-connections"),
            *("rejected", "rejected-readers"),
        ),
    ),
    Group("clock", "Clock", ("clock",)),
)
_ELSEWHERE = {*ALWAYS_SEEN, *(id for group in _GROUPS for id in group.figures)}
GROUPS = (*_GROUPS, Group("loop", "Loop", tuple(id for id in FIGURES if id not in _ELSEWHERE)))


class PageFigure(NamedTuple):
    """Text of a figure, and a line beneath it."""

    value: str
    note: str = ""


def age(live: LiveState, silent_ns: int) -> str:
    """Return the age of the figures; empty while they are current."""
    current = live.display_ended or not live.state or silent_ns < CURRENT_NS
    return "" if current else f"{silent_ns * 1e-9:.1f} s ago"


def state(live: LiveState, silent_ns: int = 0) -> tuple[str, str]:
    """Return the display's state in a word, and a note: its meaning or its age.

    silent_ns: time since the last message from the display.
    """
    word = live.state or "waiting"
    old = age(live, silent_ns)
    note = old or STATES.get("final" if live.display_ended else live.state, "")
    if not old and (reason := "; ".join(waiting_texts(word, live.summary))):
        note = f"{note}: {reason}" if word == "stale" else reason
    if not old and (word not in ("playing", "starting") or live.display_ended):
        note = "; ".join(filter(None, (note, finger_note(live.summary))))
    return ("ended" if live.display_ended and word != "fault" else word), note


def figures(live: LiveState, data: WindowScores, silent_ns: int = 0) -> dict[str, PageFigure]:
    """Return each figure with a note that says whether it is of the window or of the whole run.

    silent_ns: time since the last message from the display.
    """
    scores, old = data.scores, age(live, silent_ns)
    # The window ends at the last tick that the display has published.
    window = f"the {data.window_s:g} s until {old}" if old else f"the last {data.window_s:g} s"
    heart_rate = None if old else data.heart_rate_per_min
    shown = dict.fromkeys(FIGURES, PageFigure(NOTHING)) | {
        "force": _force(math.nan if old else data.felt_n, data.target_n),
        "heart": PageFigure(
            NOTHING if heart_rate is None else f"{heart_rate:.0f} /min",
            "of the force felt, last 6 s",
        ),
        "delay": PageFigure(NOTHING, DELAY) if old else _delay(live),
        "aligned": _error(scores.aligned_n, scores, window),
        "in_phase": _error(scores.in_phase_n, scores, window),
        "within": _within(scores, window),
        "loss": _loss(live, data, window),
        "predictor": PageFigure(live.contactor(data.chosen).playing.get("predictor") or NOTHING),
        "press": _press(live.summary.get("press", {})),
        "levels": _levels(live.depth),
    }
    if live.pressing:
        unknown = PageFigure(NOTHING, "the force felt contains the finger's own press")
        shown |= {"aligned": unknown} | dict.fromkeys(("in_phase", "within"), PageFigure(NOTHING))
    # Before the first status there is no summary.
    shown |= _rows(live.summary) if live.summary else {}
    name = live.names[data.chosen]
    if not name:
        return shown
    of_contactor = {id: shown[id] for id in ("force", "heart", "aligned", "in_phase", "within")}
    of_contactor |= _rows(_own(live, name), bool(live.summary.get("faults")))
    return shown | {
        id: PageFigure(value, f"{name}: {note}" if note else name)
        for id, (value, note) in of_contactor.items()
    }


def _rows(summary: Fields, after_fault: bool | None = None) -> dict[str, PageFigure]:
    """Return the rows of a summary's JSON, by the ids of their figures."""
    rows = summary_rows(summary, Surface.PAGE, after_fault)
    return {row.name.replace(" ", "-"): PageFigure(row.large, row.note) for row in rows}


def _own(live: LiveState, name: str) -> Fields:
    """Return the figures of one of several contactors in the summary.

    Availability is that of the display; a contactor has the time that its errors could be judged.
    """
    figures: Fields = live.summary.get("contactors", {}).get(name, {})
    return {key: value for key, value in figures.items() if key != "availability"}


# Columns of the table of several contactors.
CONTACTOR_COLUMNS = (
    *("contactor", "channel", "force now", ALIGNED, IN_PHASE),
    *("height", "rate", "quality", "finger"),
)


def contactor_rows(live: LiveState, data: WindowScores, silent_ns: int = 0) -> list[list[str]]:
    """Return the rows of the table of several contactors; none for an only one.

    silent_ns: time since the last message from the display.
    """
    rows, old = [], age(live, silent_ns)
    for name, contactor, scores in zip(live.names, live.contactors, data.all_scores, strict=True):
        if not name:
            return []
        own, channel = _own(live, name), contactor.playing["channel"]
        beats = own.get("beats", {})
        newest_n = contactor.ticks.since(live.now_ns).values[:, FELT_N]
        force_n = newest_n[-1] if len(newest_n) and not old else math.nan
        rate_per_min, quality = beats.get("rate_per_min"), beats.get("quality")
        rows.append(
            [
                name,
                live.channels[channel] if channel < len(live.channels) else str(channel),
                _whole_mn(None if math.isnan(force_n) else force_n),
                NEWTONS.text(scores.aligned_n) or NOTHING,
                NEWTONS.text(scores.in_phase_n) or NOTHING,
                _whole_mn(beats.get("height_n")),
                NOTHING if rate_per_min is None else f"{rate_per_min:.0f} /min",
                NOTHING if quality is None else f"{quality:.2f}",
                describe_finger(finger_in(own)) or NOTHING,
            ]
        )
    return rows


def beyond(live: LiveState) -> str:
    """Return a sentence on the contactors for which the page has no room; empty without any."""
    if not live.beyond:
        return ""
    count = count_text(live.beyond, "more contactor")
    return f"{count} of the display not shown: the page has room for {MAX_CONTACTORS}."


def _whole_mn(force_n: float | None) -> str:
    return NOTHING if force_n is None else f"{force_n * 1e3:.0f} mN"


def _error(error_n: float | None, scores: Scores, window: str) -> PageFigure:
    note = f"of {window}"
    # A constant pulse has no peak to peak.
    if error_n is not None and scores.jnd_n:
        note += f", {SHARE.text(JND * error_n / scores.jnd_n)} of the pulse's peak to peak"
    return PageFigure(NEWTONS.text(error_n) or NOTHING, note)


def _within(scores: Scores, window: str) -> PageFigure:
    """Return the share within the JND, and the share of the window that it refers to."""
    if scores.within_jnd is None or scores.judged is None:
        return PageFigure(NOTHING, f"of {window}, none of which could be judged")
    note = (
        f"a finger notices an error for {SHARE.text(1 - scores.within_jnd)} of the time, of the"
        f" {SHARE.text(scores.judged)} of {window} that could be judged"
    )
    return PageFigure(SHARE.text(scores.within_jnd), note)


def _loss(live: LiveState, data: WindowScores, window: str) -> PageFigure:
    """Return the share of samples lost or late in the window, and their counts since the start."""
    samples: Fields = live.summary.get("samples", {})
    lost, late = samples.get("lost"), samples.get("late")
    if lost is None or late is None:
        return PageFigure(NOTHING)
    percent = sum(live.missing(round(data.window_s * SECOND_NS)))
    note = (
        f"of {window}; since the display started: {count_text(lost, 'sample')} lost, {late} late,"
        f" {samples.get('predicted', 0)} predicted"
    )
    return PageFigure(NOTHING if math.isnan(percent) else f"{percent:.2f} %", note)


def _force(felt_n: float, target_n: float) -> PageFigure:
    note = "of the target force, peaks of the last 2 s"
    if math.isnan(felt_n) or math.isnan(target_n):
        return PageFigure(NOTHING, note)
    return PageFigure(f"{felt_n * 1e3:.0f} of {target_n * 1e3:.0f} mN", note)


def _delay(live: LiveState) -> PageFigure:
    """Return the present playout delay, and the trust in the prediction where it is used."""
    delays_ns = live.contactors[0].ticks.since(live.now_ns).values[:, DELAY_NS]
    if not len(delays_ns) or np.isnan(delays_ns[-1]):
        return PageFigure(NOTHING, DELAY)
    delay, trust = delay_note(delays_ns[-1] * 1e-6, live.trusted, live.summary)
    return PageFigure(delay, f"{DELAY}, {trust}" if trust else DELAY)


def _press(press: Fields) -> PageFigure:
    """Return the finger's press, the hold-down that it gives, and the loop's gain."""
    if "press_n" not in press:
        return PageFigure(NOTHING)
    # A little below 0 N is no −0.00 N.
    held_n = press.get("hold_down_n")
    texts = [] if held_n is None else [f"wrist {round(held_n, 2) + 0.0:.2f} N"]
    texts += [f"loop gain {press['loop_gain']:.4f}"] if "loop_gain" in press else []
    texts += [f"probe {press['probe']}"] if press.get("probe") else []
    return PageFigure(f"finger {press['press_n']:.2f} N", ", ".join(texts))


def _levels(depth: DepthState) -> PageFigure:
    """Return the best hold-down and the two levels around it, as far as the beats show them."""
    if not depth.pressed:
        return PageFigure(NOTHING)
    good = sum(point.quality >= GOOD for point in depth.points)
    of = f"{good} good of {count_text(len(depth.points), 'beat')} at a steady hold-down"
    if depth.curve is None:
        return PageFigure(NOTHING, f"too few for a curve: {of}")
    texts = {
        name: "not reached" if at_n is None else f"{at_n:.2f} N"
        for name, at_n in levels(depth.curve).items()
    }
    note = f"light {texts['light']}, deepest {texts['deepest']}; {of}"
    return PageFigure(f"best {texts['deeper']}", note)


def calm(live: LiveState) -> tuple[bool, str]:
    """Return whether the alarms are known, and what is shown where there is none."""
    known = bool(live.state)
    return known, "No alarm." if known else ALARMS_UNKNOWN


def alarms(live: LiveState, silent_ns: int) -> list[Alert]:
    """Return the present alarms; silent_ns: time since the last message from the display."""
    if not live.state:
        return []
    found = alerts(live.state, live.summary, live.display_ended, silent_ns)
    if live.display_ended or silent_ns > SILENT_AFTER_NS:
        return found
    if live.frame_ns and not live.stream_ended and live.now_ns - live.frame_ns > CUT_AFTER_NS:
        found.append(Alert(AlertKind.LINK_CUT, "no frame arrives from the sensing node"))
    return found + _counted(live)


def _counted(live: LiveState) -> list[Alert]:
    found = []
    recent = live.statuses.since(live.now_ns - SHOWN_NS).values
    if len(recent):
        for (key, kind), column in zip(REFUSALS.items(), (REFUSED, READERS_REFUSED), strict=True):
            if refused := int(np.ptp(recent[:, column])):
                causes = "; ".join(explain_causes(live.summary[key]))
                further = (f"of the whole run {causes}",)
                found.append(Alert(kind, f"{refused} in the last 5 s", further))
        if np.ptp(recent[:, LIMITED]) > 0:
            limits = [
                f"{name}: {text}" if name else text
                for name, figures in contactors_of(live.summary).items()
                for text in limit_texts(figures["limited"])
            ]
            found.append(Alert(AlertKind.LIMITED, "; ".join(limits)))
        missing = recent[-1, LOST] + recent[-1, LATE]
        if missing > MUCH_LOSS:
            text = f"{missing:.0f} % of the last second's samples are lost or late"
            found.append(Alert(AlertKind.LOSS, text))
    if live.now_ns - live.stepped_ns < SHOWN_NS:
        text = "a clock has jumped; its offset is estimated again"
        found.append(Alert(AlertKind.CLOCK_STEP, text))
    if live.now_ns - live.telemetry_missed_ns < SHOWN_NS:
        text = "this page is too slow for the display's telemetry"
        found.append(Alert(AlertKind.MISSED, text))
    return found
