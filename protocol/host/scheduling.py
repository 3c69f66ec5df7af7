"""Measures for when the loop runs and where, each of which holds as long as a `with` lasts.

They yield what was done, and raise NotGrantedError.

What this process may do, and how it is told that it may not.
"""

import ctypes
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from protocol.errors import RealtimeError
from protocol.host.realtime_request import spans

# From <linux/capability.h>.
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23
LIMITS_FILE = "/etc/security/limits.d/telepulse.conf"


class NotGrantedError(RealtimeError):
    """A measure is not granted. reason: why; advice: what to do about it."""

    def __init__(self, reason: str, advice: str) -> None:
        super().__init__(reason)
        self.reason = reason
        self.advice = advice


def capable(number: int) -> bool:
    """Whether this process has a capability of Linux."""
    for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
        if line.startswith("CapEff:"):
            return bool(int(line.split()[1], 16) >> number & 1)
    return False


def raise_limit(item: str, value: str, unit_key: str, docker: str) -> str:
    """How to raise a resource limit: at a login, in a systemd unit, in a container."""
    return (
        f'put "USER - {item} {value}" into {LIMITS_FILE} and log in anew'
        f" (systemd: {unit_key}; docker run {docker})"
    )


# From <linux/prctl.h>.
PR_SET_TIMERSLACK, PR_GET_TIMERSLACK = 29, 30
LEAST_SLACK_NS = 1
# So long may a thread with a priority run without a pause; a tick takes thousandths of it.
LONGEST_RUN_US = 200_000
# And so long until the kernel ends a process that cannot be asked any more to give it up.
LONGEST_RUN_AT_ALL_US = 2_000_000
BEGIN_WITHIN_S = 1.0


@contextmanager
def first_in_first_out(priority: int, on_overrun: Callable[[], None]) -> Iterator[str]:
    """The calling thread runs before all others when it has to, and so do its helpers, after it.

    A thread that runs on for 0.2 s without a pause would keep the machine from everyone else: then
    the priority is given up for good, and `on_overrun` called. The main thread's alone, as it
    handles a signal. Threads that are started meanwhile have the priority as well: who holds
    Python's lock must not be kept from running while the loop waits for it.
    """
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        threads = helpers()
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
        _schedule(set(filter(_has_priority, threads | _started())), *before)

    def overrun(number: int, frame: FrameType | None) -> None:
        give_up()
        on_overrun()

    try:
        # A step below: what floods the network must not delay a tick.
        _schedule(threads, os.SCHED_FIFO, os.sched_param(max(1, priority - 1)))
        with _watched(overrun):
            beside = f", {len(threads)} threads that help it a step below" if threads else ""
            yield f"SCHED_FIFO{beside}"
    finally:
        give_up()


@contextmanager
def pinned(cpus: frozenset[int]) -> Iterator[str]:
    """The calling thread runs on these processors alone; its helpers may run on any."""
    before = os.sched_getaffinity(0)
    advice = f"this process may use {spans(frozenset(before))}"
    try:
        os.sched_setaffinity(0, cpus)
    except OSError as error:
        raise NotGrantedError(f"sched_setaffinity: {error.strerror}", advice) from None
    try:
        if os.sched_getaffinity(0) != cpus:
            # The kernel leaves out those that are not there, and says nothing.
            raise NotGrantedError("not all of these processors are there", advice)
        yield f"on processor {spans(cpus)} alone"
    finally:
        os.sched_setaffinity(0, before)


@contextmanager
def prompt() -> Iterator[str]:
    """The calling thread's timers go off when they are due, not up to 50 µs later."""
    libc = ctypes.CDLL(None, use_errno=True)
    before_ns = libc.prctl(PR_GET_TIMERSLACK, 0, 0, 0, 0)
    if libc.prctl(PR_SET_TIMERSLACK, LEAST_SLACK_NS, 0, 0, 0):
        reason = f"prctl: {os.strerror(ctypes.get_errno())}"
        raise NotGrantedError(reason, "Linux 2.6.28 and later have it")
    try:
        yield f"timers late by {LEAST_SLACK_NS} ns at most, not {before_ns}"
    finally:
        libc.prctl(PR_SET_TIMERSLACK, before_ns, 0, 0, 0)


def helpers() -> set[int]:
    """The other threads of this process that the loop depends on: ZeroMQ's and Python's.

    Not numpy's: they spin while they wait, which must not have a priority.
    """
    tasks = _tasks()
    deadline_s = time.monotonic() + BEGIN_WITHIN_S
    # ZeroMQ's have no name of their own until they have run up to their first wait.
    while not all(map(_has_waited, tasks)) and time.monotonic() < deadline_s:
        time.sleep(0.001)
    found = {thread.native_id for thread in threading.enumerate()}
    for task in tasks:
        with suppress(OSError):  # it may have ended
            if (task / "comm").read_text(encoding="utf-8", errors="replace").startswith("ZMQ"):
                found.add(_number(task))
    return {number for number in found if number is not None} - {threading.get_native_id()}


def _started() -> set[int]:
    """Return the threads of this process, as far as they can be listed.

    Python's own are known without /proc, whose listing takes a file descriptor: where none is left,
    a priority must be given up all the same.
    """
    started = {thread.native_id or 0 for thread in threading.enumerate()} | {0}
    with suppress(OSError):
        started.update(map(_number, _tasks()))
    return started


def _tasks() -> list[Path]:
    return list(Path("/proc/self/task").iterdir())


def _number(task: Path) -> int:
    return int(task.name)


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


# In quotes, as other systems have no such type.
def _schedule(threads: set[int], policy: int, parameter: "os.sched_param") -> None:
    for thread in threads:
        with suppress(ProcessLookupError):
            os.sched_setscheduler(thread, policy, parameter)


@contextmanager
def _watched(overrun: Callable[[int, FrameType | None], None]) -> Iterator[None]:
    """Call `overrun` when a thread with a priority runs on for too long."""
    import resource  # not on every system

    soft, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    if hard == resource.RLIM_INFINITY:
        hard = LONGEST_RUN_AT_ALL_US
    before = signal.signal(signal.SIGXCPU, overrun)
    resource.setrlimit(resource.RLIMIT_RTTIME, (min(LONGEST_RUN_US, hard), hard))
    try:
        yield
    finally:
        # The hard limit can be raised again with rights alone that few have, and binds nobody.
        resource.setrlimit(resource.RLIMIT_RTTIME, (hard if soft < 0 else min(soft, hard), hard))
        signal.signal(signal.SIGXCPU, before)


def _no_priority(priority: int, error: OSError) -> NotGrantedError:
    import resource  # not on every system

    limit = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    if 0 <= limit < priority and not capable(CAP_SYS_NICE):
        return NotGrantedError(
            f"RLIMIT_RTPRIO is {limit}",
            raise_limit(
                "rtprio", str(priority), f"LimitRTPRIO={priority}", f"--ulimit rtprio={priority}"
            ),
        )
    return NotGrantedError(
        f"sched_setscheduler: {error.strerror}",
        "the limits allow it, so the control group does not: write 950000 into its"
        " cpu.rt_runtime_us and its parents', or docker run --cpu-rt-runtime=950000",
    )
