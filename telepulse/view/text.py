"""The figures of the page, as text. Pure."""

from typing import NamedTuple

from display_node.scoring.tracking_error import JND
from display_node.telemetry.alerts import finger_note
from protocol.availability import availability_text, part_text
from protocol.config.quantities import count_text
from protocol.histogram import bound
from protocol.limits import limit_texts
from telepulse.telemetry.transcript import Fields
from telepulse.view.live import LiveState
from telepulse.view.picture import Picture, PictureScores

NOTHING = "–"
# Statuses come five times a second; after so long nothing that is shown is current.
CURRENT_NS = 1_000_000_000
# What follows a state, for people who do not know it.
STATES = {
    "": "no display has been heard yet",
    "waiting": "for the sensing node",
    "starting": "the pulse comes up",
    "playing": "the pulse is felt",
    "stale": "no samples to play",
    "ended": "the stream is over",
    "fault": "latched until the display is started again",
    "final": "the display has ended; this is its last state",
}


# The figures by their ids on the page.
FIGURES = {
    "heart": "heart rate",
    "aligned": "aligned error",
    "in_phase": "in-phase error",
    "within": "within JND",
    "felt": "felt",
    "one_way": "one-way delay",
    "playout": "playout delay",
    "loss": "loss",
    "offset": "clock offset",
    "skew": "clock skew",
    "predictor": "predictor",
    "misses": "deadline misses",
    "refused": "refused",
    "limited": "limited",
}


class PageFigure(NamedTuple):
    """The text of a figure, and a line beneath it."""

    value: str
    note: str = ""


def age(live: LiveState, silent_ns: int) -> str:
    """Return how old all figures are, where they are not current; else nothing."""
    current = live.final or not live.state or silent_ns < CURRENT_NS
    return "" if current else f"{silent_ns * 1e-9:.1f} s ago"


def state(live: LiveState, silent_ns: int = 0) -> tuple[str, str]:
    """Return the display's state in a word, and what it means or how old it is.

    silent_ns: for how long nothing came from the display.
    """
    word = live.state or "waiting"
    old = age(live, silent_ns)
    note = old or STATES.get("final" if live.final else live.state, "")
    if not old and (word not in ("playing", "starting") or live.final):
        note += finger_note(live.summary)
    return ("ended" if live.final and word != "fault" else word), note


def figures(live: LiveState, picture: Picture, silent_ns: int = 0) -> dict[str, PageFigure]:
    """Return each figure, with what time it is of: the window or the whole run.

    silent_ns: for how long nothing came from the display.
    """
    s, scores = live.summary, picture.scores
    one_way, playout = s.get("one_way_delay_ms", {}), s.get("playout_delay_ms", {})
    window = f"the last {picture.window_s:g} s"
    heart_rate = None if age(live, silent_ns) else picture.heart_rate_per_min
    clock, loop, refused = s.get("clock", {}), s.get("loop", {}), s.get("rejected", {})
    return {
        "heart": PageFigure(_show(heart_rate, "{:.0f} /min"), "of the force felt, last 6 s"),
        "aligned": _error(scores.aligned_n, scores, window),
        "in_phase": _error(scores.in_phase_n, scores, window),
        "within": _within(scores, window),
        "felt": _felt(s.get("availability", {})),
        "one_way": _delay(one_way, "p50", "median"),
        "playout": _delay(playout, "mean", "mean"),
        "loss": _loss(s.get("samples", {})),
        "offset": _offset(clock),
        "skew": PageFigure(_show(clock.get("skew_ppm"), "{:+.1f} ppm"), "sensing against display"),
        "predictor": _predictor(s, live.predictor),
        "misses": PageFigure(
            _show(loop.get("deadline_misses"), "{}"),
            _show(loop.get("ticks"), "of {} ticks of the run"),
        ),
        "refused": PageFigure(
            count_text(sum(refused.values()), "message") if s else NOTHING,
            f"{', '.join(sorted(refused))}{' in ' if refused else 'in '}the run" if s else "",
        ),
        "limited": _limited(s.get("limited", {})),
    }


def _show(value: float | None, form: str) -> str:
    return NOTHING if value is None else form.format(value)


def _percent(share: float | None, digits: int = 1) -> str:
    return NOTHING if share is None else f"{100 * share:.{digits}f} %"


def _delay(delay_ms: Fields, key: str, kind: str) -> PageFigure:
    """Return a delay of the whole run by its mean or median, and its 99th percentile."""
    p99_ms = delay_ms.get("p99")
    beyond = delay_ms.get("beyond", [])
    where = "not within" if "p99" in beyond else "below"
    note = "" if p99_ms is None else f"{kind} of the run; 99 % {where} {p99_ms:.1f} ms"
    return PageFigure(f"{bound(key, beyond)}{_show(delay_ms.get(key), '{:.1f} ms')}", note)


def _error(error_n: float | None, scores: PictureScores, window: str) -> PageFigure:
    if error_n is None or not scores.jnd_n:
        return PageFigure(NOTHING, f"RMS of {window}")
    share = JND * error_n / scores.jnd_n
    note = f"RMS of {window}, {_percent(share)} of the pulse's height"
    return PageFigure(f"{error_n * 1e3:.2f} mN", note)


def _within(scores: PictureScores, window: str) -> PageFigure:
    """Return the share within the JND, with what part of the window it is of."""
    if scores.within_jnd is None or scores.judged is None:
        return PageFigure(NOTHING, f"of {window}, none of which could be judged")
    note = f"of the {_percent(scores.judged)} of {window} that could be judged"
    return PageFigure(_percent(scores.within_jnd), note)


def _felt(availability: Fields) -> PageFigure:
    """Return the share of the run in which the pulse was felt, and what the rest of it was."""
    return PageFigure(_percent(availability.get("felt")), availability_text(availability) or "")


def _loss(samples: Fields) -> PageFigure:
    lost, late = samples.get("lost"), samples.get("late")
    if lost is None or late is None:
        return PageFigure(NOTHING)
    due = lost + late + samples.get("played", 0)
    share = (lost + late) / due if due else 0.0
    return PageFigure(
        _percent(share, 2), f"{count_text(lost, 'sample')} lost, {late} late in the run"
    )


def _offset(clock: Fields) -> PageFigure:
    if "offset_ms" not in clock:
        return PageFigure(NOTHING)
    offset_ms = clock["offset_ms"]
    # Clocks of two hosts begin at different times, and may be days apart.
    value = f"{offset_ms:.3f} ms" if abs(offset_ms) < 1e4 else f"{offset_ms * 1e-3:.3f} s"
    uncertainty = _show(clock.get("uncertainty_ms"), "± {:.3f} ms, ")
    return PageFigure(value, f"{uncertainty}sensing minus display")


def _limited(limits: Fields) -> PageFigure:
    """Return the time at the limit that held longest, and one phrase for each limit."""
    known = [limit for limit in limits.values() if "times" in limit]
    seconds = [limit["seconds"] for limit in known if limit["times"]]
    if not seconds:
        return PageFigure(
            "never" if known else NOTHING, "by force, slew or travel" if known else ""
        )
    return PageFigure(f"{max(seconds):.1f} s", "; ".join(limit_texts(limits)))


def _predictor(summary: Fields, name: str) -> PageFigure:
    compensation = summary.get("compensation", {})
    predicted, trusted = compensation.get("predicted"), compensation.get("trusted")
    part = part_text(summary.get("availability", {}).get("played"))
    stood_in = f"stood in {_percent(predicted)} of {part} that was played"
    if trusted is not None:
        stood_in += f", trusted {_percent(trusted)}"
    return PageFigure(name or _percent(predicted), stood_in)
