"""State of a display as a line in a terminal, from its telemetry: what matters in that state.

The line has whole items by importance, the alerts last. Pure.
"""

import math
from collections import deque
from collections.abc import Hashable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from rich.text import Text

from display_node.scoring.heart_rate import heart_rate_per_min
from display_node.telemetry.alerts import (
    WITHOUT_SAMPLES,
    Alert,
    AlertKind,
    alerts,
    finger_text,
    waiting_texts,
)
from display_node.telemetry.status_age import StatusAge
from protocol.errors import WireError
from protocol.wire.marks import MARK, Mark, read_mark
from protocol.wire.telemetry import STATUS, TRACE, Status, Trace, read_status, read_trace

# Half a wide terminal; a log or a journal shows it without wrapping.
LINE_WIDTH = 100


def compose(state: str, items: Sequence[str], alerts: Sequence[Alert]) -> str:
    """Return state, items and alerts in one line of at most `LINE_WIDTH` characters.

    Nothing is cut: an item that has no room is left out, the last ones first. Alerts come last: as
    the first that has room of their texts, their names with the reasons, their names, and their
    number. Each is printed in full elsewhere: below the line in a terminal, else once when it
    begins.
    """
    state = state if len(state) <= LINE_WIDTH // 2 else "unknown state"
    # A fault need not repeat the state.
    names = [_printable(each.subject if each.kind.value == state else each.name) for each in alerts]
    texts, reasons = (
        [f"{name}: {_printable(text)}" for name, text in zip(names, parts, strict=True)]
        for parts in ([each.text for each in alerts], [each.reason for each in alerts])
    )
    last = _first_that_fits(
        ["; ".join(names), f"{len(alerts)} alerts"], LINE_WIDTH - len(f"{state}: ")
    )
    shown: list[str] = []
    for item in items:
        if item and len(_line(state, [*shown, item], last)) <= LINE_WIDTH:
            shown.append(item)
    longer = (_line(state, shown, "; ".join(each)) for each in (texts, reasons))
    return _first_that_fits([*longer, _line(state, shown, last)], LINE_WIDTH)


def _first_that_fits(texts: Sequence[str], width: int) -> str:
    return next((text for text in texts if len(text) <= width), "")


def _line(state: str, items: Sequence[str], last: str) -> str:
    told = "; ".join(text for text in (", ".join(items), last) if text)
    return f"{state}: {told}" if told else state


# One tick in 10 ms is kept, for 6 s.
KEEP_NS, APART_NS = 6_000_000_000, 10_000_000
# Statuses come each 0.4 s; one that is older than this is not shown as current.
CURRENT_NS = 1_000_000_000


class TerminalTick(NamedTuple):
    """A kept tick, with fields of `TickState`."""

    now_ns: int
    instant_ns: int
    target_n: float
    felt_n: float
    full: bool


def _no_ticks() -> deque[TerminalTick]:
    return deque(maxlen=KEEP_NS // APART_NS + 1)


def _heart_rate_per_min(ticks: Sequence[TerminalTick]) -> float | None:
    t_s = np.array([tick.now_ns * 1e-9 for tick in ticks])
    felt_n = [tick.felt_n if tick.full else math.nan for tick in ticks]
    return heart_rate_per_min(t_s, np.array(felt_n))


class TerminalView:
    """State of a display as a line, with its alerts.

    local: whether its address is on this machine. unreadable: number of unreadable messages.
    """

    def __init__(self, local: bool = False) -> None:
        # Of each contactor; that of the first one is always there.
        self._ticks = [_no_ticks()]
        self._age = StatusAge(local)
        self._trusted = False
        self.status: Status | None = None
        self.unreadable = 0
        self.mark: Mark | None = None
        # Identities of alerts that `new_alerts` has returned and that are still active.
        self._named: set[Hashable] = set()

    def take(self, message: Sequence[bytes], now_ns: int = 0) -> list[Trace]:
        """Take a telemetry message that arrived at `now_ns`; return the traces in it."""
        try:
            match message:
                case [topic, data] if topic == TRACE:
                    traces = read_trace(data)
                    self.add_trace(*traces)
                    if len(traces[0].now_ns):
                        self._age.take_trace(int(traces[0].now_ns[-1]), now_ns)
                    return traces
                case [topic, data] if topic == STATUS:
                    self.status = read_status(data)
                    self._age.take_status(now_ns)
                case [topic, data] if topic == MARK:
                    self.mark = read_mark(data)
                case _:
                    self.unreadable += 1
        except WireError:
            self.unreadable += 1
        return []

    def add_trace(self, *traces: Trace) -> None:
        """Take ticks of each contactor; where their clock goes back, the earlier are removed."""
        if len(traces) != len(self._ticks):
            self._ticks = [_no_ticks() for _ in traces]
        if len(traces[0].trusted):
            self._trusted = bool(traces[0].trusted[-1])
        for ticks, trace in zip(self._ticks, traces, strict=True):
            columns = (trace.now_ns, trace.instant_ns, trace.target_n, trace.felt_n, trace.full)
            for tick in map(TerminalTick, *(column.tolist() for column in columns)):
                if ticks and tick.now_ns < ticks[-1].now_ns:
                    ticks.clear()
                if not ticks or tick.now_ns - ticks[-1].now_ns >= APART_NS:
                    ticks.append(tick)
            while ticks and ticks[0].now_ns < ticks[-1].now_ns - KEEP_NS:
                ticks.popleft()

    @property
    def heart_rates_per_min(self) -> list[float | None]:
        """Heart rate of the pulse that each finger feels; None while none is at full strength."""
        return [_heart_rate_per_min(ticks) for ticks in self._ticks]

    def line(self, now_ns: int = 0) -> str:
        """Return the state at `now_ns` in one line: what matters in it, and the alerts."""
        if self.status is None:
            return "waiting for the display"
        state = self.status.state
        found = [
            alert
            for alert in self._alerts(now_ns)
            if not (alert.kind is AlertKind.STALE and state == "stale")
        ]
        items = self._line_items(state) if self._age_ns(now_ns) < CURRENT_NS else []
        return compose(self._state(now_ns), items, found)

    def _line_items(self, state: str) -> list[str]:
        """Return the items of a current status line, the most important first."""
        assert self.status is not None
        summary = self.status.summary
        finger = _printable(finger_text(summary))
        resting = [f"finger {finger}"] if finger else []
        if state == "fault":
            return resting
        if state in WITHOUT_SAMPLES:
            if state == "waiting" and summary.get("refused"):
                # No force is played yet: the room is for the reason, which is an alert.
                return []
            first = ["no samples to play"] if state == "stale" else []
            reasons = [_printable(text) for text in waiting_texts(state, summary)]
            reason = "; ".join(reasons)
            if len(_line(state, [*first, reason], "")) > LINE_WIDTH:
                # Of several addresses, the first one's.
                reason = reasons[0]
            return [*first, reason, *resting]
        if state == "ended" or self.status.final:
            return [_account_text(summary)]
        rates = [f"{rate:.0f}" for rate in self.heart_rates_per_min if rate is not None]
        press, delay_ms = self._press_text(), self._delay_ms()
        return [
            f"heart rate {', '.join(rates)} /min" if rates else "",
            self._force_text(),
            f"press {press}" if press else "",
            "" if delay_ms is None else f"delay {delay_ms:.1f} ms{self._shortened(delay_ms)}",
            _missing_text(summary),
            f"telemetry not readable {self.unreadable} times" if self.unreadable else "",
        ]

    def _shortened(self, delay_ms: float) -> str:
        """Return the network's delay where prediction makes that of the finger shorter."""
        summary = {} if self.status is None else self.status.summary
        network_ms = summary.get("one_way_delay_ms", {}).get("p50")
        if not self._trusted or network_ms is None or network_ms <= delay_ms:
            return ""
        return f" (network {network_ms:.1f})"

    def _force_text(self) -> str:
        """Return the felt force against the target, of each contactor."""
        newest = [(ticks[-1].felt_n, ticks[-1].target_n) for ticks in self._ticks if ticks]
        felt, target = (
            (
                ", ".join("unknown" if math.isnan(n) else f"{1e3 * n:.0f}" for n in forces)
                for forces in zip(*newest, strict=True)
            )
            if newest
            else ("", "")
        )
        return f"felt {felt} of {target} mN" if newest else ""

    def new_alerts(self, now_ns: int = 0) -> list[str]:
        """Return in full the alerts that were not active at the last call."""
        found = self._alerts(now_ns) if self.status is not None else []
        before, self._named = self._named, {alert.identity for alert in found}
        return [_in_full(alert) for alert in found if alert.identity not in before]

    def live(self, now_ns: int = 0) -> Text:
        """Return the line at `now_ns`, dim where it is not current, and the alerts in full."""
        if self.status is None:
            return Text(self.line(now_ns))
        shown = Text(self.line(now_ns), "" if self._age_ns(now_ns) < CURRENT_NS else "dim")
        for alert in self._alerts(now_ns):
            shown.append(f"\n{_in_full(alert)}", "bold red")
        return shown

    def _alerts(self, now_ns: int) -> list[Alert]:
        assert self.status is not None
        status = self.status
        return alerts(status.state, status.summary, status.final, self._age_ns(now_ns))

    def _age_ns(self, now_ns: int) -> int:
        """Return the age of the newest status; 0 once the display has ended."""
        ended = self.status is not None and self.status.final
        return 0 if ended else self._age.age_ns(now_ns) or 0

    def _state(self, now_ns: int) -> str:
        """Return the display's state, with the age of the status where it is not current."""
        assert self.status is not None
        age_ns, state = self._age_ns(now_ns), _printable(self.status.state)
        return state if age_ns < CURRENT_NS else f"{state} {age_ns * 1e-9:.1f} s ago"

    def _press_text(self) -> str:
        """Return the finger's press, the hold-down at the wrist, and the state of the probe."""
        press = {} if self.status is None else self.status.summary.get("press", {})
        if press.get("press_n") is None:
            return ""
        if press.get("probe") == "held":
            return f"{1e3 * press['press_n']:.0f} mN, but another display holds the wrist"
        if press.get("hold_down_n") is None:
            return f"{1e3 * press['press_n']:.0f} mN, no answer of the wrist yet"
        at_wrist = f"wrist {1e3 * press['hold_down_n']:.0f} mN"
        return f"{1e3 * press['press_n']:.0f} mN, {at_wrist} {_printable(press['probe'] or '')}"

    def _delay_ms(self) -> float | None:
        """Return the playout delay of the last tick; None while no pulse is felt."""
        summary = {} if self.status is None else self.status.summary
        offset_ms = summary.get("clock", {}).get("offset_ms")
        last = self._ticks[0][-1] if self._ticks[0] else None
        if offset_ms is None or last is None or not last.full:
            return None
        # An E of 0 is known to the clock's error only.
        return max(0.0, (last.now_ns - last.instant_ns) * 1e-6 + float(offset_ms))


def _missing_text(summary: Mapping[str, Any]) -> str:
    """Return how many samples were lost or late; empty where none was."""
    samples = summary.get("samples", {})
    counts = ((samples.get(key), key) for key in ("lost", "late"))
    return " and ".join(f"{count} {word}" for count, word in counts if count)


def _account_text(summary: Mapping[str, Any]) -> str:
    """Return how many of the samples were lost or late."""
    sent = summary.get("samples", {}).get("sent")
    return f"{_missing_text(summary) or 'none lost'} of {sent} samples" if sent else ""


def _in_full(alert: Alert) -> str:
    return _printable(f"{alert.name}: {alert.text}")


def _printable(text: str) -> str:
    """Replace unprintable characters in a text from a status, which could control the terminal."""
    return "".join(character if character.isprintable() else "?" for character in text)
