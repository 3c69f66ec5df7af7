"""The figures of the page, as text. Pure."""

from typing import NamedTuple

from display_node.alerts import finger_note
from display_node.fidelity import JND
from protocol.limits import limit_texts
from telepulse.record.heard_fields import Fields
from telepulse.view.live import Live
from telepulse.view.picture import Picture, Scores

NOTHING = "–"
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
    """What a figure says, and a line beneath it."""

    value: str
    note: str = ""


def state(live: Live) -> tuple[str, str]:
    """The display's state in a word, and what it means."""
    word = live.state or "waiting"
    note = STATES.get("final" if live.final else live.state, "")
    if word not in ("playing", "starting") or live.final:
        note += finger_note(live.summary)
    return ("ended" if live.final and word != "fault" else word), note


def figures(live: Live, picture: Picture) -> dict[str, Figure]:
    """What each figure says."""
    s, scores = live.summary, picture.scores
    one_way, playout = s.get("one_way_delay_ms", {}), s.get("playout_delay_ms", {})
    clock, loop, refused = s.get("clock", {}), s.get("loop", {}), s.get("rejected", {})
    return {
        "heart": Figure(_show(picture.heart_rate_per_min, "{:.0f} /min"), "of the force felt"),
        "aligned": _error(scores.aligned_n, scores),
        "in_phase": _error(scores.in_phase_n, scores),
        "within": Figure(_percent(scores.within_jnd), "of the window, aligned error"),
        "one_way": _delay(one_way.get("p50"), "median", one_way.get("p99")),
        "playout": _delay(playout.get("mean"), "mean", playout.get("p99")),
        "loss": _loss(s.get("samples", {})),
        "offset": _offset(clock),
        "skew": Figure(_show(clock.get("skew_ppm"), "{:+.1f} ppm"), "sensing against display"),
        "predictor": _predictor(s.get("compensation", {}), live.predictor),
        "misses": Figure(
            _show(loop.get("deadline_misses"), "{}"), _show(loop.get("ticks"), "of {} ticks")
        ),
        "refused": Figure(
            f"{sum(refused.values())} messages" if s else NOTHING, ", ".join(sorted(refused))
        ),
        "limited": _limited(s.get("limited", {})),
    }


def _show(value: float | None, form: str) -> str:
    return NOTHING if value is None else form.format(value)


def _percent(share: float | None, digits: int = 1) -> str:
    return NOTHING if share is None else f"{100 * share:.{digits}f} %"


def _delay(value_ms: float | None, kind: str, p99_ms: float | None) -> Figure:
    note = "" if p99_ms is None else f"{kind}; 99 % below {p99_ms:.1f} ms"
    return Figure(_show(value_ms, "{:.1f} ms"), note)


def _error(error_n: float | None, scores: Scores) -> Figure:
    if error_n is None or not scores.jnd_n:
        return Figure(NOTHING, "RMS of the window")
    share = JND * error_n / scores.jnd_n
    return Figure(f"{error_n * 1e3:.2f} mN", f"RMS, {_percent(share)} of the pulse's height")


def _loss(samples: Fields) -> Figure:
    lost, late = samples.get("lost"), samples.get("late")
    if lost is None or late is None:
        return Figure(NOTHING)
    due = lost + late + samples.get("played", 0)
    share = (lost + late) / due if due else 0.0
    return Figure(_percent(share, 2), f"{lost} samples lost, {late} late")


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


def _predictor(compensation: Fields, name: str) -> Figure:
    predicted, trusted = compensation.get("predicted"), compensation.get("trusted")
    stood_in = f"stood in {_percent(predicted)} of the time"
    if trusted is not None:
        stood_in += f", trusted {_percent(trusted)}"
    return Figure(name or _percent(predicted), stood_in)
