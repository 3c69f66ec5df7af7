"""Ending a node from outside: Ctrl-C, SIGTERM and a terminal that closes ask it to finish."""

import signal
from collections.abc import Callable
from types import FrameType


def interrupt_on_signals() -> None:
    """Raise KeyboardInterrupt on the signals that end a node, while it has no loop to stop yet."""

    def handle(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    _handle(handle)


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Call `stop` on SIGINT, SIGTERM and, unless `nohup` has it ignored, SIGHUP."""

    def handle(number: int, frame: FrameType | None) -> None:
        stop()

    _handle(handle)


def _handle(handle: Callable[[int, FrameType | None], None]) -> None:
    signal.signal(signal.SIGINT, handle)
    signal.signal(signal.SIGTERM, handle)
    # Its default ends the process at once: no drive would be withdrawn.
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, handle)
