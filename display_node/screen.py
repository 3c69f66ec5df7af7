"""The live state in a terminal, drawn from the telemetry by a process of its own.

`python -m display_node.screen ADDRESS [KEY]` shows a display's telemetry: a panel in a terminal, a
line a second elsewhere. It ends with the display, or with the process that started it. KEY is the
display's own secret key file, where its telemetry is protected.
"""

import os
import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from display_node.heart_rate import heart_rate_per_min
from display_node.telemetry import STATUS, TRACE, Status, Trace, read_status, read_trace
from protocol import sockets
from protocol.errors import WireError
from protocol.keys import ClientKeys, read_pair
from protocol.output import unblocked_output

FRAMES_PER_S = 8
LINE_EVERY_S = 1.0
KEEP_S = 6.0
THIN = 10
PLOT_S = 3.0
PLOT_COLUMNS, PLOT_ROWS = 64, 6
BRAILLE_BITS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))


class Screen:
    """What is known of a display, and how it looks."""

    def __init__(self) -> None:
        self._times_s: deque[float] = deque()
        self._target_n: deque[float] = deque()
        self._felt_n: deque[float] = deque()
        self.status: Status | None = None
        # Messages that could not be read.
        self.unreadable = 0

    def take(self, message: Sequence[bytes]) -> Trace | None:
        """Take a telemetry message, of its topic and its data; the trace where it is one."""
        try:
            match message:
                case [topic, data] if topic == TRACE:
                    trace = read_trace(data)
                    self.add_trace(trace)
                    return trace
                case [topic, data] if topic == STATUS:
                    self.status = read_status(data)
                case _:
                    self.unreadable += 1
        except WireError:
            self.unreadable += 1
        return None

    def add_trace(self, trace: Trace) -> None:
        """Take ticks; every tenth is kept, for 6 s."""
        self._times_s.extend((trace.now_ns[::THIN] * 1e-9).tolist())
        self._target_n.extend(trace.target_n[::THIN].tolist())
        self._felt_n.extend(trace.felt_n[::THIN].tolist())
        while self._times_s and self._times_s[0] < self._times_s[-1] - KEEP_S:
            self._times_s.popleft()
            self._target_n.popleft()
            self._felt_n.popleft()

    @property
    def heart_rate_per_min(self) -> float | None:
        """Heart rate of the pulse that is felt."""
        return heart_rate_per_min(np.array(self._times_s), np.array(self._felt_n))

    def line(self) -> str:
        """The state in one line."""
        if self.status is None:
            return "waiting for the display"
        return f"{self.status.state}: " + ", ".join(f"{n} {v}" for n, v in self._rows())

    def panel(self) -> RenderableType:
        """The state as a panel."""
        if self.status is None:
            return Panel("waiting for the display", title="telepulse")
        table = Table(show_header=False, box=None, pad_edge=False)
        rows = self._rows()
        half = (len(rows) + 1) // 2
        for left, right in zip(rows[:half], [*rows[half:], ("", "")], strict=False):
            table.add_row(left[0], Text(left[1], "bold"), "  ", right[0], Text(right[1], "bold"))
        stream = "".join(c if c.isprintable() else "?" for c in self.status.stream)
        title = Text(f"telepulse · {stream or 'no stream'} · {self.status.state}")
        return Panel(Group(table, Text(), *self._plot()), title=title, expand=False)

    def _rows(self) -> list[tuple[str, str]]:
        assert self.status is not None
        s = self.status.summary
        rate = self.heart_rate_per_min
        target_n = self._target_n[-1] if self._target_n else None
        felt_n = self._felt_n[-1] if self._felt_n else None
        return [
            ("heart rate", _show(rate, "/min", 0)),
            ("force target", _show(target_n, "mN", 1, 1e3)),
            ("force felt", _show(felt_n, "mN", 1, 1e3)),
            ("strain RMSE", _exponent(s["strain_rmse"]["aligned"])),
            ("force RMSE", _show(s["force_rmse_n"]["aligned"], "mN", 3, 1e3)),
            ("one-way delay p50", _show(s["one_way_delay_ms"]["p50"], "ms")),
            ("one-way delay p99", _show(s["one_way_delay_ms"]["p99"], "ms")),
            ("playout delay", _show(s["playout_delay_ms"]["mean"], "ms")),
            ("predicted", _show(s["compensation"]["predicted"], "%", 1, 100)),
            ("energy above 25 Hz", _show(s["roughness"]["energy_ratio"], "of the sensed", 2)),
            ("samples late", _count(s["samples"]["late"])),
            ("samples lost", _count(s["samples"]["lost"])),
            ("samples played", _count(s["samples"]["played"])),
            ("deadline misses", _count(s["loop"]["deadline_misses"])),
            *([("telemetry not readable", str(self.unreadable))] if self.unreadable else []),
        ]

    def _plot(self) -> list[RenderableType]:
        count = round(PLOT_S * 1000 / THIN)
        felt, target = list(self._felt_n)[-count:], list(self._target_n)[-count:]
        if len(felt) < 2:
            return [Text("no pulse yet", "dim")]
        low, high = min(*felt, *target), max(*felt, *target)
        return [
            Text("felt (line) over target (dots), last 3 s", "dim"),
            *_braille(felt, target, low, high),
            Text(f"{low * 1e3:.0f} to {high * 1e3:.0f} mN", "dim"),
        ]


def _braille(
    line: Sequence[float], dots: Sequence[float], low: float, high: float
) -> list[RenderableType]:
    """A curve as a line and one as dots, in braille characters of 2 × 4 dots a cell."""
    columns, rows = 2 * PLOT_COLUMNS, 4 * PLOT_ROWS
    cells = [[0] * PLOT_COLUMNS for _ in range(PLOT_ROWS)]
    line_y, dots_y = (_heights(curve, columns, rows, low, high) for curve in (line, dots))
    for x in range(columns):
        before, here = line_y[max(x - 1, 0)], line_y[x]
        # The line runs down or up to where the column before it ended.
        marked = {*range(min(before + 1, here), max(before, here + 1))}
        if x % 3 == 0:
            marked.add(dots_y[x])
        for y in marked:
            cells[y // 4][x // 2] |= BRAILLE_BITS[x % 2][y % 4]
    return [Text("".join(chr(0x2800 + cell) for cell in row), "cyan") for row in cells]


def _heights(curve: Sequence[float], columns: int, rows: int, low: float, high: float) -> list[int]:
    """The curve at each column, as a row counted from the top."""
    at = np.interp(np.linspace(0, len(curve) - 1, columns), np.arange(len(curve)), curve)
    share = (at - low) / (high - low) if high > low else np.zeros(columns)
    heights: list[int] = (rows - 1 - np.rint(share * (rows - 1)).astype(int)).tolist()
    return heights


def _show(value: float | None, unit: str, digits: int = 1, scale: float = 1.0) -> str:
    return "–" if value is None else f"{value * scale:.{digits}f} {unit}"


def _count(value: Any) -> str:
    return "–" if value is None else str(value)


def _exponent(value: float | None) -> str:
    return "–" if value is None else f"{value:.2e}"


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
    screen = Screen()
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
            for message in sockets.receive_all(socket):
                trace = screen.take(message)
                if trace is not None and on_trace is not None:
                    on_trace(trace)
                if screen.status is not None and screen.status.final:
                    return screen.status
            if live is not None:
                live.update(screen.panel())
            elif draw and time.monotonic() - line_s >= LINE_EVERY_S:
                line_s = time.monotonic()
                console.print(screen.line(), soft_wrap=True)
        return screen.status
    finally:
        if live is not None:
            live.update(screen.panel())
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
