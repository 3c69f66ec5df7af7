"""Units of the figures, and phrases for those that are no single number: shares, limits, times."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from protocol.config.quantities import count_text
from protocol.faults import faults_of, notes_of
from protocol.finger import describe_finger, finger_in
from protocol.refusals import explain_causes
from protocol.summary.fields import STATES, awaited_in


class Unit(NamedTuple):
    """Unit of a figure: its name in JSON, and the name and the format of a number in a text.

    factor: multiplies the JSON's value for the text. base: multiplies it for Prometheus.
    """

    name: str
    shown: str
    form: str
    factor: float = 1.0
    base: float = 1.0

    def text(self, value: float | None) -> str:
        """Return a value with its unit; empty without a value. One that rounds to 0 has no sign."""
        if value is None:
            return ""
        number = f"{value * self.factor:z{self.form}}" if self.form else f"{value}"
        return f"{number} {self.shown}".rstrip()


COUNT: Final = Unit("", "", "")
NEWTONS: Final = Unit("N", "mN", ".3f", factor=1e3)
SHARE: Final = Unit("share, 0 to 1", "%", ".1f", factor=100.0)
UNITS: Final[Mapping[str, Unit]] = {
    "s": Unit("s", "s", ".2f"),
    "ms": Unit("ms", "ms", ".2f", base=1e-3),
    "µs": Unit("µs", "µs", ".0f", base=1e-6),
    "ppm": Unit("ppm", "ppm", ".1f", base=1e-6),
    "N": NEWTONS,
    "strain": Unit("strain", "", ".3e"),
    "share": SHARE,
    "ratio": Unit("ratio", "", ".2f"),
    "1/min": Unit("1/min", "/min", ".0f", base=1 / 60),
}


Json = Mapping[str, Any]
# Keys of `Limits` → the limit's name for people.
LIMIT_NAMES: Final = {
    "force": "force limit",
    "negative": "force below 0 N",
    "slew": "slew limit",
    "travel": "end of travel",
    "film": "film's ADC range",
    "adc": "ADC range",
}


def availability_text(shares: Json) -> str | None:
    """Return the shares that are not 0 in one phrase whose figures add up to 100.0 %.

    shares: `Availability` as a summary's JSON has it. Returns None before the first tick.
    """
    names = {**dict(zip(STATES, STATES, strict=True)), "missed": "missed ticks"}
    known = {name: share for key, name in names.items() if (share := shares.get(key))}
    if shares.get("seconds") is None or not known:
        return None
    # All are rounded down; the remainder to 100.0 % is given to those that lost most.
    tenths = {name: int(1000 * share) for name, share in known.items()}
    missing = round(1000 * sum(known.values())) - sum(tenths.values())
    for name in sorted(known, key=lambda name: tenths[name] - 1000 * known[name])[:missing]:
        tenths[name] += 1
    found = [f"{name} {n / 10:.1f} %" if n else f"{name} < 0.1 %" for name, n in tenths.items()]
    return f"{', '.join(found)} of {shares['seconds']:.1f} s"


def interruptions_text(known: Json) -> str | None:
    """Return the interruptions of a run, as JSON has them, in one phrase; None without any."""
    count, seconds, longest_s = (known.get(key) for key in ("count", "seconds", "longest_s"))
    if not count or seconds is None or longest_s is None:
        return None
    return f"{count_text(count, 'time')}, {seconds:.2f} s in all, the longest {longest_s:.2f} s"


def limit_texts(limits: Mapping[str, Json]) -> list[str]:
    """Return one phrase for each limit that was reached, the one that held longest first.

    limits: `Limits` as a summary's JSON has it: times, seconds and share for each key.
    """
    found = []
    for key, name in LIMIT_NAMES.items():
        times, seconds, share = (
            limits.get(key, {}).get(each) or 0 for each in ("times", "seconds", "share")
        )
        if times:
            held = f"{seconds:.1f} s" if seconds >= 0.1 else f"{seconds * 1e3:.3g} ms"
            # A share above 0 is not printed as 0.0 %.
            percent = "< 0.1" if 0 < share < 5e-4 else f"{100 * share:.1f}"
            text = f"{name} {count_text(times, 'time')}, {held} ({percent} % of the run)"
            found.append((seconds, text))
    return [text for _, text in sorted(found, key=lambda one: -one[0])]


def longest_limit_text(limits: Mapping[str, Json]) -> str:
    """Return the time at the limit that held longest; empty while no limit is known to apply."""
    known = [limit for limit in limits.values() if limit.get("times") is not None]
    seconds = [limit.get("seconds") or 0.0 for limit in known if limit["times"]]
    return f"{max(seconds):.1f} s" if seconds else "never" if known else ""


def windows_text(contactors: Sequence[Sequence[Json]]) -> str | None:
    """Return a line for each window of time, with the largest error of several contactors."""
    lines = []
    for each, *others in zip(*contactors, strict=False):
        # The last window ends with the run.
        until = f"{each['to_s']:.1f}".removesuffix(".0")
        times = f"{each['from_s']:.0f} to {until} s"
        # An E of 0 is known to the clock's error only; "z" prints no sign before a zero.
        parts = [f"{times}: E {each['playout_delay_ms']:z.1f} ms"]
        for name, key in (("aligned", "aligned_n"), ("in phase", "in_phase_n")):
            errors_n = [found[key] for found in (each, *others) if found[key] is not None]
            most = "at most " if others else ""
            parts.append(f"{name} {most}{NEWTONS.text(max(errors_n, default=None)) or 'unknown'}")
        lines.append(", ".join(parts))
    return _joined(lines, "\n")


def _offset_text(offset_ms: float) -> str:
    """Return an offset in ms; in s for clocks of two hosts, which may be days apart."""
    return f"{offset_ms:z.3f} ms" if abs(offset_ms) < 1e4 else f"{offset_ms * 1e-3:z.3f} s"


def _joined(values: Iterable[str], between: str = ", ") -> str | None:
    """Join texts into one line; return None without any."""
    return between.join(values) or None


PHRASES: Final[Mapping[str, Callable[[Any], str | None]]] = {
    "availability": availability_text,
    "causes": lambda rejected: "\n".join(explain_causes(rejected)) or "nothing",
    "causes_if_any": lambda rejected: _joined(explain_causes(rejected), "\n"),
    "counts": lambda counts: _joined(f"{n} {name}" for name, n in sorted(counts.items())),
    "faults": lambda faults: "; ".join(map(str, faults_of({"faults": faults}))) or "none",
    "finger": lambda finger: describe_finger(finger_in({"finger": finger})) or None,
    "first_copies": lambda first: _joined(f"{n} first over {name}" for name, n in first.items()),
    "interruptions": interruptions_text,
    "limits": lambda limits: _joined(limit_texts(limits), "; "),
    "list": _joined,
    "notes": lambda notes: _joined(map(str, notes_of({"notes": notes})), "; "),
    "offset": _offset_text,
    "reasons": lambda reasons: _joined(map(str, awaited_in({"waiting_for": reasons})), "; "),
    "text": lambda text: text or None,
    "windows": lambda windows: windows_text([windows]),
}
HEADLINES: Final[Mapping[str, Callable[[Any], str]]] = {
    "count": lambda interruptions: COUNT.text(interruptions.get("count")),
    "felt_share": lambda shares: SHARE.text(shares.get("felt")),
    "longest_limit": longest_limit_text,
    "messages": lambda rejected: count_text(sum(rejected.values()), "message"),
}
