"""Progress of a simulation, in a line on a terminal."""

import sys
import time
from types import TracebackType
from typing import Self

from rich.console import Console
from rich.live import Live
from rich.text import Text

# A simulation that takes less time than the first value shows none. Then the line is rewritten so
# often.
FIRST_S, EVERY_S = 1.5, 0.25


class SimulationProgress:
    """A line on stderr with the simulated time, rewritten in place; use it within a `with`.

    It is erased at the end. Where stderr is no terminal, nothing is written.
    """

    def __init__(self, seconds: float) -> None:
        """Begin a simulation of a number of seconds."""
        self._seconds = seconds
        console = Console(stderr=True)
        shown = sys.stderr.isatty() and not console.is_dumb_terminal
        # It writes log lines above its own one.
        self._live = (
            Live(console=console, auto_refresh=False, transient=True, redirect_stdout=False)
            if shown
            else None
        )
        self._begin_s = time.perf_counter()
        self._next_s = self._begin_s + FIRST_S

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Erase the line."""
        if self._live is not None:
            self._live.stop()

    def add(self, simulated_s: float) -> None:
        """State how much is simulated by now; call it often."""
        if self._live is None or (now_s := time.perf_counter()) < self._next_s:
            return
        self._next_s = now_s + EVERY_S
        done_s = min(simulated_s, self._seconds)
        self._live.start()
        self._live.update(
            Text(progress_text(done_s, self._seconds, now_s - self._begin_s)), refresh=True
        )


def progress_text(done_s: float, seconds: float, elapsed_s: float) -> str:
    """Return the line after `elapsed_s` of computing."""
    return f"simulated {done_s:.0f} of {seconds:g} s, {done_s / elapsed_s:.1f} times real time"
