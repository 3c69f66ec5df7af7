"""Linux's settings for a loop in real time: priority, processors, timers, memory.

Each is a context manager that yields what was done, and undoes it at its end.
"""

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from protocol.errors import RealtimeError

if sys.platform != "win32":
    import resource

# From <linux/capability.h>, <linux/prctl.h> and <sys/mman.h>.
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23
PR_SET_TIMERSLACK, PR_GET_TIMERSLACK = 29, 30
MCL_CURRENT, MCL_FUTURE, MCL_ONFAULT = 1, 2, 4
LIMITS_FILE = "/etc/security/limits.d/telepulse.conf"
LEAST_SLACK_NS = 1
# Time for which a thread with a priority may run without a pause; a tick takes 1/1000 of it.
LONGEST_RUN_US = 200_000
# Time after which the kernel ends a process that does not give its priority up.
LONGEST_RUN_AT_ALL_US = 2_000_000
THREADS_START_WITHIN_S = 1.0


class NotGrantedError(RealtimeError):
    """A real-time setting is not granted; the arguments are the reason and advice."""


@contextmanager
def schedule_fifo(priority: int, on_overrun: Callable[[], None]) -> Iterator[str]:
    """Run the calling thread under SCHED_FIFO, and its helper threads one step below.

    A thread that runs for 0.2 s without a pause blocks the machine: the priority is then given up
    for good, and `on_overrun` is called. Call it in the main thread, which handles signals. Threads
    that start within the `with` inherit the priority: a thread that holds Python's lock must be
    able to run while the loop waits for that lock.
    """
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        threads = helper_threads()
    except OSError as error:
        raise NotGrantedError(
            f"/proc/self/task cannot be listed: {error.strerror}",
            "a process needs free descriptors",
        ) from None
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError as error:
        raise _no_priority(priority, error) from None

    def give_up() -> None:
        _schedule({thread for thread in threads | _started() if _has_priority(thread)}, *before)

    def overrun(number: int, frame: FrameType | None) -> None:
        give_up()
        on_overrun()

    try:
        # One step below the loop, so that a flood of frames does not delay a tick.
        _schedule(threads, os.SCHED_FIFO, os.sched_param(max(1, priority - 1)))
        with _watched(overrun):
            beside = f", {len(threads)} threads that help it a step below" if threads else ""
            yield f"SCHED_FIFO{beside}"
    finally:
        give_up()


@contextmanager
def pin(cpus: frozenset[int]) -> Iterator[str]:
    """Run the calling thread on these processors alone; its helper threads may run on any."""
    before = os.sched_getaffinity(0)
    advice = f"this process may use {spans(frozenset(before))}"
    try:
        os.sched_setaffinity(0, cpus)
    except OSError as error:
        raise NotGrantedError(f"sched_setaffinity: {error.strerror}", advice) from None
    try:
        if os.sched_getaffinity(0) != cpus:
            # The kernel leaves out processors that do not exist, without an error.
            raise NotGrantedError("not all of these processors exist", advice)
        yield f"on processor {spans(cpus)} alone"
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def reduce_timer_slack() -> Iterator[str]:
    """Fire the calling thread's timers when they are due, not up to 50 µs later."""
    libc = ctypes.CDLL(None, use_errno=True)
    before_ns = libc.prctl(PR_GET_TIMERSLACK, 0, 0, 0, 0)
    if libc.prctl(PR_SET_TIMERSLACK, LEAST_SLACK_NS, 0, 0, 0):
        raise NotGrantedError(f"prctl: {_error()}", "Linux 2.6.28 and later have it")
    try:
        yield f"timers late by {LEAST_SLACK_NS} ns at most, not {before_ns}"
    finally:
        libc.prctl(PR_SET_TIMERSLACK, before_ns, 0, 0, 0)


@contextmanager
def lock_memory() -> Iterator[str]:
    """Keep all memory in use in RAM: neither swapped, nor dropped and read from its file again."""
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if limit != resource.RLIM_INFINITY and not _capable(CAP_IPC_LOCK):
        # mlockall would succeed now, and later allocations beyond the limit would fail.
        raise NotGrantedError(
            f"RLIMIT_MEMLOCK is {limit >> 10} KiB, which a node may outgrow",
            _raise_limit("memlock", "unlimited", "infinity", "-1"),
        )
    libc = ctypes.CDLL(None, use_errno=True)
    # MCL_ONFAULT locks pages when they are used. Without it, unused pages are read in too: that
    # takes four times the memory, and a new thread takes milliseconds to fill its stack.
    if libc.mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT):
        raise NotGrantedError(f"mlockall: {_error()}", "Linux 4.4 and later have it")
    try:
        yield "memory in use stays in RAM"
    finally:
        libc.munlockall()


def helper_threads() -> set[int]:
    """Return the threads of this process that the loop depends on: ZeroMQ's and Python's.

    numpy's threads are left out: they spin while they wait, and would block a processor.
    """
    tasks = _tasks()
    deadline_s = time.monotonic() + THREADS_START_WITHIN_S
    # ZeroMQ's threads set their names before their first wait.
    while not all(map(_has_waited, tasks)) and time.monotonic() < deadline_s:
        time.sleep(0.001)
    found = {thread.native_id for thread in threading.enumerate()}
    for task in tasks:
        with suppress(OSError):  # it may have ended
            if (task / "comm").read_text(encoding="utf-8", errors="replace").startswith("ZMQ"):
                found.add(int(task.name))
    return {number for number in found if number is not None} - {threading.get_native_id()}


def _started() -> set[int]:
    """Return the threads of this process, as far as they can be listed.

    Listing /proc takes a file descriptor. Without a free one, Python's own list is used.
    """
    started = {thread.native_id or 0 for thread in threading.enumerate()} | {0}
    with suppress(OSError):
        started.update(int(task.name) for task in _tasks())
    return started


def _tasks() -> list[Path]:
    return list(Path("/proc/self/task").iterdir())


def _has_priority(thread: int) -> bool:
    try:
        return os.sched_getscheduler(thread) == os.SCHED_FIFO
    except ProcessLookupError:
        return False


def _has_waited(task: Path) -> bool:
    try:
        status = (task / "status").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return True
    return "\nvoluntary_ctxt_switches:\t0\n" not in status


# The type is quoted because other systems lack it.
def _schedule(threads: set[int], policy: int, parameter: "os.sched_param") -> None:
    for thread in threads:
        with suppress(ProcessLookupError):
            os.sched_setscheduler(thread, policy, parameter)


@contextmanager
def _watched(overrun: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Call `overrun` when a thread with a priority runs for too long without a pause."""
    soft, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    if hard == resource.RLIM_INFINITY:
        hard = LONGEST_RUN_AT_ALL_US
    before = signal.signal(signal.SIGXCPU, overrun)
    resource.setrlimit(resource.RLIMIT_RTTIME, (min(LONGEST_RUN_US, hard), hard))
    try:
        yield
    finally:
        # The hard limit stays, because raising it requires a privilege.
        resource.setrlimit(resource.RLIMIT_RTTIME, (hard if soft < 0 else min(soft, hard), hard))
        signal.signal(signal.SIGXCPU, before)


def _no_priority(priority: int, error: OSError) -> NotGrantedError:
    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    if 0 <= limit < priority and not _capable(CAP_SYS_NICE):
        advice = _raise_limit("rtprio", *[f"{priority}"] * 3)
        return NotGrantedError(f"RLIMIT_RTPRIO is {limit}", advice)
    return NotGrantedError(
        f"sched_setscheduler: {error.strerror}",
        "the limits allow it, so the control group does not: write 950000 into its"
        " cpu.rt_runtime_us and its parents', or docker run --cpu-rt-runtime=950000",
    )


def spans(cpus: frozenset[int]) -> str:
    """Return processors as text, such as `0-1, 3`."""
    starts = sorted(cpu for cpu in cpus if cpu - 1 not in cpus)
    ends = sorted(cpu for cpu in cpus if cpu + 1 not in cpus)
    pairs = zip(starts, ends, strict=True)
    return ", ".join(f"{a}" if a == b else f"{a}-{b}" for a, b in pairs)


def _capable(number: int) -> bool:
    status = Path("/proc/self/status").read_text(encoding="ascii")
    return bool(int(status.partition("CapEff:")[2].split()[0], 16) >> number & 1)


def _raise_limit(item: str, value: str, systemd: str, docker: str) -> str:
    """Return advice on raising a resource limit: at a login, in a systemd unit, in a container."""
    return (
        f'put "USER - {item} {value}" into {LIMITS_FILE} and log in again'
        f" (systemd: Limit{item.upper()}={systemd}; docker run --ulimit {item}={docker})"
    )


def _error() -> str:
    return os.strerror(ctypes.get_errno())
