"""Live state of a display in a terminal, drawn from the telemetry in a process of its own.

`python -m display_node.telemetry.terminal ADDRESS [KEY]` shows a display's telemetry: a line that
is renewed in a terminal, and a line a second elsewhere. It ends with the display, or with the
process that started it. KEY is the file of the display's own secret key; it is needed where the
telemetry is protected.
"""

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zmq
from rich.console import Console
from rich.live import Live

from display_node.scoring.heart_rate import heart_rate_per_min
from display_node.telemetry.terminal_view import TerminalView
from protocol import sockets
from protocol.host.output import unblocked_output
from protocol.host.process import lower_priority
from protocol.security.link_keys import ClientKeys, KeyOptions
from protocol.wire.marks import MARK
from protocol.wire.telemetry import STATUS, TRACE, Status, Trace

FRAMES_PER_S = 8
LINE_EVERY_S = 1.0


def _print_line(screen: TerminalView, console: Console) -> None:
    """Print the status line, and each alert in full when it begins."""
    now_ns = time.perf_counter_ns()
    alerts_begun = (f"alert: {text}" for text in screen.new_alerts(now_ns))
    for text in (screen.line(now_ns), *alerts_begun):
        console.print(text, soft_wrap=True)


def watch(
    address: str,
    console: Console,
    on_traces: Callable[[list[Trace]], None] | None = None,
    draw: bool = True,
    keep_watching: Callable[[], bool] = lambda: True,
    keys: ClientKeys | None = None,
) -> Status | None:
    """Follow a display's telemetry until it ends; return its last status, None without one.

    on_traces: called with the contactors' traces of each message. keep_watching: called several
    times a second; the watch ends when it returns False. A silent display does not end the watch.
    """
    if draw:
        # Imports scipy, which takes 1 s or more, before the first status line: later it would delay
        # a line, and telemetry would queue.
        heart_rate_per_min(np.empty(0), np.empty(0))
    screen = TerminalView(local=not sockets.beyond_loopback(address))
    context: sockets.Context = zmq.Context()
    socket = sockets.connect(context, zmq.XSUB, address, keys)
    for wanted in (TRACE, STATUS, MARK):
        socket.send(b"\1" + wanted)
    live = None
    if draw and console.is_terminal:
        live = Live(screen.live(), console=console, refresh_per_second=FRAMES_PER_S)
        live.start()
    try:
        _follow(screen, socket, console, on_traces, draw, live, keep_watching)
        return screen.status
    finally:
        if live is not None:
            live.update(screen.live(time.perf_counter_ns()))
            live.stop()
        context.destroy(linger=0)


def _follow(
    screen: TerminalView,
    socket: sockets.Socket,
    console: Console,
    on_traces: Callable[[list[Trace]], None] | None,
    draw: bool,
    live: Live | None,
    keep_watching: Callable[[], bool],
) -> None:
    """Read and draw until the display's last status; see `watch`."""
    line_s = time.monotonic()
    while keep_watching():
        sockets.wait_readable([socket], 1_000_000_000 // FRAMES_PER_S)
        messages = list(sockets.receive_multipart(socket))
        for message in messages:
            marked = screen.mark
            traces = screen.take(message, time.perf_counter_ns())
            if traces and on_traces is not None:
                on_traces(traces)
            if screen.mark is not None and screen.mark is not marked and draw:
                console.print(f"mark: {screen.mark.text}", soft_wrap=True)
            if screen.status is not None and screen.status.final:
                if draw and live is None:
                    # The last line shows how the display ended.
                    _print_line(screen, console)
                return
        if len(messages) == sockets.MAX_MESSAGES:
            continue  # more has queued, and only the newest is shown
        if live is not None:
            live.update(screen.live(time.perf_counter_ns()))
        elif draw and time.monotonic() - line_s >= LINE_EVERY_S:
            line_s = time.monotonic()
            _print_line(screen, console)


if __name__ == "__main__":
    lower_priority()
    # Ctrl-C ends the display, and this process ends at the display's last status.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    address, *key = sys.argv[1:]
    keys = KeyOptions(Path(key[0])).telemetry_client(address) if key else None
    parent = os.getppid()
    console = Console(markup=False, emoji=False)
    with unblocked_output():
        watch(address, console, keep_watching=lambda: os.getppid() == parent, keys=keys)
