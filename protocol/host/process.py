"""A process and its system: limits of open files and memory, and the signals that end a node.

Each display has two connections, each of them an open file. At its limit of files a process can
neither accept nor make one, nor read its allow-list; at its limit of memory ZeroMQ ends it. So a
node checks what it needs before it begins, and bounds its connections (`ConnectionBudget`).
"""

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from protocol.errors import ProcessLimitError

# For a thousand displays, and to spare.
FILES = 4_096
# What is open besides connections: libraries, logs, processes beside a node, ZeroMQ's own; and what
# is accepted before it can be cut.
RESERVED_FILES = 64
LEAST_FILES = 96
# For threads and their arenas, and for as many connections as there may be.
LEAST_FREE_BYTES = 256 << 20


def allow_connections() -> None:
    """Let this process have `FILES` open, or as many as the system allows.

    Call it before anything is bound or connected. Raises ProcessLimitError where that is too little
    for a node, or its memory is.
    """
    if sys.platform == "win32":  # which has no such limits
        return
    import resource

    present, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = FILES if most == resource.RLIM_INFINITY else min(FILES, most)
    if present != resource.RLIM_INFINITY and present < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, most))
        present = wanted
    if present != resource.RLIM_INFINITY and present < LEAST_FILES:
        raise ProcessLimitError(
            f"this process may have {present} files open, and a node needs {LEAST_FILES}; raise the"
            f" limit: ulimit -n {FILES}"
        )
    limit_bytes = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit_bytes < 0 or sys.platform != "linux":
        return
    used_pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    free_bytes = limit_bytes - used_pages * os.sysconf("SC_PAGE_SIZE")
    if free_bytes < LEAST_FREE_BYTES:
        raise ProcessLimitError(
            f"this process may use {free_bytes >> 20} MiB more of address space, and a node needs"
            f" {LEAST_FREE_BYTES >> 20}; raise the limit: ulimit -v unlimited"
        )


def connections_that_fit() -> int:
    """Return how many connections this process has files for."""
    if sys.platform == "win32":
        return FILES - RESERVED_FILES
    import resource

    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return (FILES if limit == resource.RLIM_INFINITY else limit) - RESERVED_FILES


def interrupt_on_signals() -> None:
    """Raise KeyboardInterrupt on the signals that end a node, while it has no loop to stop yet."""

    def interrupt() -> None:
        raise KeyboardInterrupt

    stop_on_signals(interrupt)


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Call `stop` on SIGINT, SIGTERM and, unless `nohup` has it ignored, SIGHUP."""

    def handle(number: int, frame: FrameType | None) -> None:
        stop()

    signal.signal(signal.SIGINT, handle)
    signal.signal(signal.SIGTERM, handle)
    # Its default ends the process at once: no drive would be withdrawn.
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, handle)
