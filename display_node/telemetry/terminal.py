"""The live state in a terminal, drawn from the telemetry by a process of its own.

`python -m display_node.telemetry.terminal ADDRESS [KEY]` shows a display's telemetry: a panel in a
terminal, a line a second elsewhere. It ends with the display, or with the process that started it.
KEY is the display's own secret key file, where its telemetry is protected.
"""

import math
import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import zmq
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from display_node.scoring.heart_rate import heart_rate_per_min
from display_node.telemetry.age import TelemetryAge
from display_node.telemetry.alerts import Alert, alerts
from display_node.telemetry.braille_plot import braille_plot, limits
from protocol import sockets
from protocol.errors import WireError
from protocol.figures import Surface
from protocol.host.output import unblocked_output
from protocol.run_summary import REGISTRY
from protocol.security.keys import ClientKeys, read_pair
from protocol.wire.telemetry import STATUS, TRACE, Status, Trace, read_status, read_trace

FRAMES_PER_S = 8
LINE_EVERY_S = 1.0
# Of the ticks: one each 10 ms, for 6 s.
KEEP_NS, APART_NS = 6_000_000_000, 10_000_000
PLOT_S = 3.0
RUN = "of the run so far"
# Of a status line: a log or a journal shows it without wrapping.
LINE_WIDTH = 120
# Room of the alerts in a status line beside its figures; each is printed in full when it begins.
ALERTS_WIDTH = 45
# Rows of the moment by importance where a line has no room for all: what the finger feels first.
IMPORTANCE = ("force felt", "finger", "force target", "heart rate")
# Statuses come five times a second; an older one is not shown as current.
CURRENT_NS = 1_000_000_000


class TerminalTick(NamedTuple):
    """A tick that is kept; felt_n is NaN where it is unknown."""

    now_ns: int
    target_n: float
    felt_n: float
    scored: bool


class TerminalView:
    """The state of a display, and how it looks.

    local: the display's address is on this machine.
    """

    def __init__(self, local: bool = False) -> None:
        self._ticks: deque[TerminalTick] = deque(maxlen=KEEP_NS // APART_NS + 1)
        self._age = TelemetryAge(local)
        self.status: Status | None = None
        # Messages that could not be read.
        self.unreadable = 0
        # Alerts that `new_alerts` has returned and that last.
        self._named: set[str] = set()

    def take(self, message: Sequence[bytes], now_ns: int = 0) -> Trace | None:
        """Take a telemetry message; return the trace where it is one.

        The message has a topic and data, and came at `now_ns` of this process's clock.
        """
        try:
            match message:
                case [topic, data] if topic == TRACE:
                    trace = read_trace(data)
                    self.add_trace(trace)
                    if len(trace.now_ns):
                        self._age.take_trace(int(trace.now_ns[-1]), now_ns)
                    return trace
                case [topic, data] if topic == STATUS:
                    self.status = read_status(data)
                    self._age.take_status(now_ns)
                case _:
                    self.unreadable += 1
        except WireError:
            self.unreadable += 1
        return None

    def add_trace(self, trace: Trace) -> None:
        """Take ticks; of each 10 ms one is kept, for 6 s. A clock that falls begins afresh."""
        columns = (trace.now_ns, trace.target_n, trace.felt_n, trace.scored)
        for tick in map(
            TerminalTick._make, zip(*(column.tolist() for column in columns), strict=True)
        ):
            if self._ticks and tick.now_ns < self._ticks[-1].now_ns:
                self._ticks.clear()
            if not self._ticks or tick.now_ns - self._ticks[-1].now_ns >= APART_NS:
                self._ticks.append(tick)
        while self._ticks and self._ticks[0].now_ns < self._ticks[-1].now_ns - KEEP_NS:
            self._ticks.popleft()

    @property
    def heart_rate_per_min(self) -> float | None:
        """Heart rate of the pulse that is felt; None while none is felt at full strength."""
        t_s = np.array([tick.now_ns * 1e-9 for tick in self._ticks])
        felt_n = [tick.felt_n if tick.scored else math.nan for tick in self._ticks]
        return heart_rate_per_min(t_s, np.array(felt_n))

    def line(self, now_ns: int = 0) -> str:
        """Return the state at `now_ns` in one line of at most `LINE_WIDTH` characters.

        Alerts are cut where the figures need their room. The figures follow by importance as far as
        they fit, then figures of the run.
        """
        if self.status is None:
            return "waiting for the display"
        # The state stands before them.
        state = f"{self.status.state}: "
        wrong = "; ".join(
            f"{name}: {text}".removeprefix(state) for name, text in self._alerts(now_ns)
        )
        now = {name: f"{name} {value}" for name, value in self._now_rows(now_ns)}
        run = [f"{name} {value}" for name, value in self._run_rows()]
        start = f"{_printable(self._state(now_ns))}: "
        free = LINE_WIDTH - len(start) - len(", ".join(now.values()))
        if wrong:
            start += f"{_cut(wrong, max(ALERTS_WIDTH, free - 2))}; "
        start, fitting = _cut(start, LINE_WIDTH), set[str]()
        # With the ", " before each but the first.
        room = LINE_WIDTH - len(start) + 2
        for name in IMPORTANCE:
            if name in now and len(now[name]) + 2 <= room:
                fitting.add(name)
                room -= len(now[name]) + 2
        line = start + ", ".join(text for name, text in now.items() if name in fitting)
        for part in run:
            if len(line) + len(part) + 2 <= LINE_WIDTH:
                line += f", {part}"
        return line

    def new_alerts(self, now_ns: int = 0) -> list[str]:
        """Return the alerts in full that were not there at the last call."""
        found = self._alerts(now_ns) if self.status is not None else []
        before, self._named = self._named, {alert.name for alert in found}
        return [f"{alert.name}: {alert.text}" for alert in found if alert.name not in before]

    def panel(self, now_ns: int = 0) -> RenderableType:
        """Return the state at `now_ns` as a panel, grey where it is not current."""
        if self.status is None:
            return Panel("waiting for the display", title="telepulse")
        current = self._age_ns(now_ns) < CURRENT_NS
        value_style = "bold" if current else "dim"
        now, run = (Table(show_header=False, box=None, pad_edge=False) for _ in range(2))
        rows = self._now_rows(now_ns)
        half = (len(rows) + 1) // 2
        for left, right in zip(rows[:half], [*rows[half:], ("", "")], strict=False):
            texts = [(left[0], ""), (left[1], value_style), ("  ", "")]
            texts += [(right[0], ""), (right[1], value_style)]
            now.add_row(*(Text(text, style) for text, style in texts))
        for name, value in self._run_rows():
            run.add_row(Text(name), Text(value, value_style))
        stream = _printable(self.status.stream)
        title = Text(f"telepulse · {stream or 'no stream'} · {self._state(now_ns)}")
        wrong = [Text(f"{name}: {text}", "bold red") for name, text in self._alerts(now_ns)]
        whole = Group(*wrong, now, Text(), *self._plot(current), Text(RUN, "dim"), run)
        return Panel(whole, title=title, expand=False, style="" if current else "dim")

    def _alerts(self, now_ns: int) -> list[Alert]:
        assert self.status is not None
        status = self.status
        found = alerts(status.state, status.summary, status.final, self._age_ns(now_ns))
        return [Alert(_printable(name), _printable(text)) for name, text in found]

    def _age_ns(self, now_ns: int) -> int:
        """Return the age of the status of a display that has not ended."""
        ended = self.status is not None and self.status.final
        return 0 if ended else self._age.age_ns(now_ns) or 0

    def _state(self, now_ns: int) -> str:
        """Return the display's state, with its age where it is not current."""
        assert self.status is not None
        age_ns, state = self._age_ns(now_ns), self.status.state
        return state if age_ns < CURRENT_NS else f"{state} {age_ns * 1e-9:.1f} s ago"

    def _now_rows(self, now_ns: int) -> list[tuple[str, str]]:
        """Return what holds at this moment; a heart rate only of a pulse that is felt now."""
        current = self._age_ns(now_ns) < CURRENT_NS
        rate = self.heart_rate_per_min if current else None
        last = self._ticks[-1] if self._ticks else None
        finger = None if self.status is None else self.status.summary.get("finger")
        return [
            ("heart rate", _show(rate, "/min", 0)),
            ("force target", _show(None if last is None else last.target_n, "mN", 1, 1e3)),
            ("force felt", _show(None if last is None else last.felt_n, "mN", 1, 1e3)),
            *([("finger", _printable(finger))] if finger and current else []),
        ]

    def _run_rows(self) -> list[tuple[str, str]]:
        """Return the figures of the whole run so far."""
        assert self.status is not None
        rows = REGISTRY.rows(self.status.summary, Surface.TERMINAL)
        unreadable = [("telemetry not readable", str(self.unreadable))] if self.unreadable else []
        return [*((row.name, row.text) for row in rows), *unreadable]

    def _plot(self, current: bool) -> list[RenderableType]:
        ticks = list(self._ticks)[-(round(PLOT_S * 1e9) // APART_NS) :]
        felt_n, target_n = [tick.felt_n for tick in ticks], [tick.target_n for tick in ticks]
        ends = limits(felt_n, target_n)
        if len(ticks) < 2 or ends is None:
            return [Text("no pulse yet", "dim")]
        low, high = ends
        return [
            Text("felt (line) over target (dots), last 3 s", "dim"),
            *braille_plot(felt_n, target_n, low, high, "cyan" if current else "dim"),
            Text(f"{low * 1e3:.0f} to {high * 1e3:.0f} mN", "dim"),
        ]


def _show(value: float | None, unit: str, digits: int = 1, scale: float = 1.0) -> str:
    if value is None:
        return "–"
    return "unknown" if math.isnan(value) else f"{value * scale:.{digits}f} {unit}"


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: max(0, width - 1)]}…"


def _printable(text: str) -> str:
    """Return text from a status, which cannot draw on the screen."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _print_line(screen: TerminalView, console: Console) -> None:
    """Print the status line, and each alert in full when it begins."""
    now_ns = time.monotonic_ns()
    alerts_begun = (f"alert: {text}" for text in screen.new_alerts(now_ns))
    for text in (screen.line(now_ns), *alerts_begun):
        console.print(text, soft_wrap=True)


def watch(
    address: str,
    console: Console,
    on_trace: Callable[[Trace], None] | None = None,
    draw: bool = True,
    meanwhile: Callable[[], bool] = lambda: True,
    keys: ClientKeys | None = None,
) -> Status | None:
    """Follow a display's telemetry until it ends; its last status, None if it never spoke.

    on_trace gets every trace as well; draw: show the state; meanwhile: called several times a
    second, ends the watch by returning False, as does nothing else while a display is silent;
    keys: where the telemetry is protected. What cannot be read is counted and shown.
    """
    if draw:
        # Loads scipy, for 1 s or more: within a line it would grow old, once connected the
        # telemetry would queue.
        heart_rate_per_min(np.empty(0), np.empty(0))
    screen = TerminalView(local=not sockets.beyond_loopback(address))
    context: sockets.Context = zmq.Context()
    socket = sockets.connect(context, zmq.SUB, address, keys)
    for wanted in (TRACE, STATUS):
        socket.subscribe(wanted)
    live = None
    if draw and console.is_terminal:
        live = Live(screen.panel(), console=console, refresh_per_second=FRAMES_PER_S)
        live.start()
    line_s = time.monotonic()
    try:
        while meanwhile():
            sockets.wait_readable([socket], 1_000_000_000 // FRAMES_PER_S)
            messages = list(sockets.receive_all(socket))
            for message in messages:
                trace = screen.take(message, time.monotonic_ns())
                if trace is not None and on_trace is not None:
                    on_trace(trace)
                if screen.status is not None and screen.status.final:
                    if draw and live is None:
                        # However it ended, the last line shows it.
                        _print_line(screen, console)
                    return screen.status
            if len(messages) == sockets.MAX_MESSAGES:
                continue  # more has queued, and only the newest is shown
            if live is not None:
                live.update(screen.panel(time.monotonic_ns()))
            elif draw and time.monotonic() - line_s >= LINE_EVERY_S:
                line_s = time.monotonic()
                _print_line(screen, console)
        return screen.status
    finally:
        if live is not None:
            live.update(screen.panel(time.monotonic_ns()))
            live.stop()
        context.destroy(linger=0)


if __name__ == "__main__":
    # The display ends on Ctrl-C and says so by its last status; then this ends too.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    address, *key = sys.argv[1:]
    pairs = [read_pair(Path(path)) for path in key]
    own = ClientKeys(pairs[0], pairs[0].public) if pairs else None
    parent = os.getppid()
    console = Console(markup=False, emoji=False)
    with unblocked_output():
        watch(address, console, meanwhile=lambda: os.getppid() == parent, keys=own)
