"""A thread that no exception ends."""

import threading
from collections.abc import Callable

# Between an error and the next step, for a step that fails before it waits.
PAUSE_S = 2e-3


class GuardedThread:
    """A thread that repeats a step until it is stopped, whatever the step raises.

    Parameters
    ----------
    name
        Name of the thread, as faults show it.
    step
        Called again and again; it waits by itself, for a short time.
    on_error
        Called in the thread with each exception of a step. What it raises itself is counted in
        `errors`, and dropped: the thread goes on.
    """

    def __init__(
        self, name: str, step: Callable[[], object], on_error: Callable[[BaseException], object]
    ) -> None:
        self.name = name
        self._step, self._on_error = step, on_error
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        #: Number of exceptions so far, those of `on_error` included.
        self.errors = 0

    def start(self) -> None:
        """Start the thread. Raises RuntimeError where the system has no further one."""
        self._thread.start()

    @property
    def stopping(self) -> bool:
        """True from `stop` on: a step that waits for long ends then."""
        return self._stopping.is_set()

    def is_alive(self) -> bool:
        """Return whether the thread runs: only `stop` ends it."""
        return self._thread.is_alive()

    def stop(self, within_s: float) -> bool:
        """End the thread after its present step; return whether it has ended within a time."""
        self._stopping.set()
        self._thread.join(within_s)
        return not self.is_alive()

    def _run(self) -> None:
        while not self._stopping.is_set():
            try:
                self._step()
            # SystemExit would end the thread without a word.
            except (Exception, SystemExit) as error:
                self.errors += 1
                self._report(error)
                self._stopping.wait(PAUSE_S)

    def _report(self, error: BaseException) -> None:
        try:
            self._on_error(error)
        except Exception:
            self.errors += 1
