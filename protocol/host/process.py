"""A process and its operating system: its limits, its priority, the signals that end it.

Each display has two connections, each of them an open file. At its limit of open files, a process
can neither open a connection nor read its allow-list; at its limit of memory, ZeroMQ aborts it. So
a node checks its limits at the start, and bounds its connections (`ConnectionBudget`).
"""

import ctypes
import gc
import os
import platform
import signal
import struct
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from protocol.errors import ProcessLimitError

if sys.platform != "win32":
    import resource

# Enough for a thousand displays, with a reserve.
FILES = 4_096
# Files besides connections: libraries, logs, sidecars, ZeroMQ's own, and connections that were
# accepted but not cut yet.
RESERVED_FILES = 64
LEAST_FILES = 96
# Enough for threads with their arenas, and for all connections.
LEAST_FREE_BYTES = 256 << 20
# Shortest time slice that Linux grants, and number of the system call that requests it.
SLICE_NS = 100_000
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274, "riscv64": 274}
# Of a process that shows or compares what a loop does.
WATCHER_NICENESS = 10


def raise_file_limit() -> None:
    """Raise this process's limit of open files to `FILES`, or as far as the system allows.

    Call it before any socket is bound or connected. Raises ProcessLimitError where a node needs a
    higher limit of open files, or of memory.
    """
    if sys.platform == "win32":  # which has no such limits
        return
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
    """Return how many connections this process may have open."""
    if sys.platform == "win32":
        return FILES - RESERVED_FILES
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return (FILES if limit == resource.RLIM_INFINITY else limit) - RESERVED_FILES


def interrupt_on_signals() -> None:
    """Raise KeyboardInterrupt on the signals that end a node, for the time before its loop."""

    def interrupt() -> None:
        raise KeyboardInterrupt

    stop_on_signals(interrupt)


def stop_on_signals(stop: Callable[[], None]) -> None:
    """Call `stop` on SIGINT, SIGTERM and SIGHUP; the last stays ignored under `nohup`."""

    def handle(number: int, frame: FrameType | None) -> None:
        stop()

    signal.signal(signal.SIGINT, handle)
    signal.signal(signal.SIGTERM, handle)
    # SIGHUP's default ends the process at once, without a withdrawal of the drive.
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        signal.signal(signal.SIGHUP, handle)


def lower_priority() -> None:
    """Let other programs run first, where this system can: for what only shows a loop's work.

    A page or a scorer beside two nodes on two cores would otherwise delay their loops.
    """
    if hasattr(os, "nice"):
        os.nice(WATCHER_NICENESS)


def request_short_slices() -> None:
    """Request short time slices, so that this process runs soon after it wakes; needs no rights.

    From Linux 6.12 on, a task that wakes preempts one whose slice is longer, and the share of time
    of both stays the same (`sched_setattr(2)`, `sched_runtime`). Earlier kernels ignore it. Threads
    that start later inherit it, so call it first.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if sys.platform != "linux" or number is None:
        return
    # struct sched_attr of <linux/sched/types.h>: size, policy, flags, nice, priority, runtime,
    # deadline, period.
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = struct.pack("=IIQiIQQQ", 48, os.SCHED_OTHER, 0, nice, 0, SLICE_NS, 0, 0)
    ctypes.CDLL(None).syscall(number, 0, attributes, 0)


def freeze_objects() -> None:
    """Exclude all objects that exist from garbage collection (`gc.freeze`).

    Call it once before a loop, and before a drive moves: it takes some 20 ms. Without it, a full
    collection in the middle of a stream would delay 20 samples.
    """
    gc.collect()
    gc.freeze()
