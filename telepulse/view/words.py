"""The figures of the page, as text. Pure."""

from typing import NamedTuple

from display_node.alerts import finger_note
from display_node.fidelity import JND
from protocol.availability import availability_text, part_text
from protocol.counted import counted
from protocol.histogram import bound
from protocol.limits import limit_texts
from telepulse.record.heard_fields import Fields
from telepulse.view.live import Live
from telepulse.view.picture import Picture, Scores

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


class Figure(NamedTuple):
    """The text of a figure, and a line beneath it."""

    value: str
    note: str = ""


def age(live: Live, silent_ns: int) -> str:
    """Return how old all figures are, where they are not current; else nothing."""
    current = live.final or not live.state or silent_ns < CURRENT_NS
    return "" if current else f"{silent_ns * 1e-9:.1f} s ago"


def state(live: Live, silent_ns: int = 0) -> tuple[str, str]:
    """Return the display's state in a word, and what it means or how old it is.

    silent_ns: for how long nothing came from the display.
    """
    word = live.state or "waiting"
    old = age(live, silent_ns)
    note = old or STATES.get("final" if live.final else live.state, "")
    if not old and (word not in ("playing", "starting") or live.final):
        note += finger_note(live.summary)
    return ("ended" if live.final and word != "fault" else word), note


def figures(live: Live, picture: Picture, silent_ns: int = 0) -> dict[str, Figure]:
    """Return each figure, with what time it is of: the window or the whole run.

    silent_ns: for how long nothing came from the display.
    """
    s, scores = live.summary, picture.scores
    one_way, playout = s.get("one_way_delay_ms", {}), s.get("playout_delay_ms", {})
    window = f"the last {picture.window_s:g} s"
    heart_rate = None if age(live, silent_ns) else picture.heart_rate_per_min
    clock, loop, refused = s.get("clock", {}), s.get("loop", {}), s.get("rejected", {})
    return {
        "heart": Figure(_show(heart_rate, "{:.0f} /min"), "of the force felt, last 6 s"),
        "aligned": _error(scores.aligned_n, scores, window),
        "in_phase": _error(scores.in_phase_n, scores, window),
        "within": _within(scores, window),
        "felt": _felt(s.get("availability", {})),
        "one_way": _delay(one_way, "p50", "median"),
        "playout": _delay(playout, "mean", "mean"),
        "loss": _loss(s.get("samples", {})),
        "offset": _offset(clock),
        "skew": Figure(_show(clock.get("skew_ppm"), "{:+.1f} ppm"), "sensing against display"),
        "predictor": _predictor(s, live.predictor),
        "misses": Figure(
            _show(loop.get("deadline_misses"), "{}"),
            _show(loop.get("ticks"), "of {} ticks of the run"),
        ),
        "refused": Figure(
            counted(sum(refused.values()), "message") if s else NOTHING,
            f"{', '.join(sorted(refused))}{' in ' if refused else 'in '}the run" if s else "",
        ),
        "limited": _limited(s.get("limited", {})),
    }


def _show(value: float | None, form: str) -> str:
    return NOTHING if value is None else form.format(value)


def _percent(share: float | None, digits: int = 1) -> str:
    return NOTHING if share is None else f"{100 * share:.{digits}f} %"


def _delay(delay_ms: Fields, key: str, kind: str) -> Figure:
    """Return a delay of the whole run by its mean or median, and its 99th percentile."""
    p99_ms = delay_ms.get("p99")
    beyond = delay_ms.get("beyond", [])
    where = "not within" if "p99" in beyond else "below"
    note = "" if p99_ms is None else f"{kind} of the run; 99 % {where} {p99_ms:.1f} ms"
    return Figure(f"{bound(key, beyond)}{_show(delay_ms.get(key), '{:.1f} ms')}", note)


def _error(error_n: float | None, scores: Scores, window: str) -> Figure:
    if error_n is None or not scores.jnd_n:
        return Figure(NOTHING, f"RMS of {window}")
    share = JND * error_n / scores.jnd_n
    note = f"RMS of {window}, {_percent(share)} of the pulse's height"
    return Figure(f"{error_n * 1e3:.2f} mN", note)


def _within(scores: Scores, window: str) -> Figure:
    """Return the share within the JND, with what part of the window it is of."""
    if scores.within_jnd is None or scores.judged is None:
        return Figure(NOTHING, f"of {window}, none of which could be judged")
    note = f"of the {_percent(scores.judged)} of {window} that could be judged"
    return Figure(_percent(scores.within_jnd), note)


def _felt(availability: Fields) -> Figure:
    """Return the share of the run in which the pulse was felt, and what the rest of it was."""
    return Figure(_percent(availability.get("felt")), availability_text(availability) or "")


def _loss(samples: Fields) -> Figure:
    lost, late = samples.get("lost"), samples.get("late")
    if lost is None or late is None:
        return Figure(NOTHING)
    due = lost + late + samples.get("played", 0)
    share = (lost + late) / due if due else 0.0
    return Figure(_percent(share, 2), f"{counted(lost, 'sample')} lost, {late} late in the run")


def _offset(clock: Fields) -> Figure:
    if "offset_ms" not in clock:
        return Figure(NOTHING)
    offset_ms = clock["offset_ms"]
    # Clocks of two hosts begin at different times, and may be days apart.
    value = f"{offset_ms:.3f} ms" if abs(offset_ms) < 1e4 else f"{offset_ms * 1e-3:.3f} s"
    uncertainty = _show(clock.get("uncertainty_ms"), "± {:.3f} ms, ")
    return Figure(value, f"{uncertainty}sensing minus display")


def _limited(limits: Fields) -> Figure:
    """Return the time at the limit that held longest, and one phrase for each limit."""
    known = [limit for limit in limits.values() if "times" in limit]
    seconds = [limit["seconds"] for limit in known if limit["times"]]
    if not seconds:
        return Figure("never" if known else NOTHING, "by force, slew or travel" if known else "")
    return Figure(f"{max(seconds):.1f} s", "; ".join(limit_texts(limits)))


def _predictor(summary: Fields, name: str) -> Figure:
    compensation = summary.get("compensation", {})
    predicted, trusted = compensation.get("predicted"), compensation.get("trusted")
    part = part_text(summary.get("availability", {}).get("played"))
    stood_in = f"stood in {_percent(predicted)} of {part} that was played"
    if trusted is not None:
        stood_in += f", trusted {_percent(trusted)}"
    return Figure(name or _percent(predicted), stood_in)
