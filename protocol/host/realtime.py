"""A real-time loop: its pacing, and the operating system's settings that keep it on time.

A request (`RealtimeRequest`) is parsed from text such as "fifo=40,lock,slack". `apply_realtime`
applies its settings within a `with`, and yields which were granted or refused (`RealtimeGrant`).
"""

import logging
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import NamedTuple

from protocol.errors import RealtimeError, suggest
from protocol.host.linux import (
    LONGEST_RUN_US,
    NotGrantedError,
    lock_memory,
    pin,
    reduce_timer_slack,
    schedule_fifo,
    spans,
)

logger = logging.getLogger(__name__)

MEASURES = ("fifo", "lock", "cpu", "slack", "strict")
# Below 50, at which a PREEMPT_RT kernel runs the threads that bring frames from the network.
FIFO_PRIORITY = 40
# 99 is the kernel's own.
MAX_PRIORITY = 98
MAX_CPU = 4095
GIVEN_UP = " given up"


class PacedTick(NamedTuple):
    """A tick that begins; where ticks were missed, it stands for them too.

    due_ns: when the newest tick that it stands for was due. late_ns: time since the oldest of them
    was due. elapsed_ticks: periods since the last tick that ran.
    """

    due_ns: int
    late_ns: int
    elapsed_ticks: int


class Pacer:
    """Pacing of a loop that ticks at a fixed period. Pure: the caller waits.

    The first tick is due a period after construction. Later ones keep to its grid, however late
    each begins. A tick that begins after the next one was due stands for both. due_ns: when the
    next tick is due. missed: ticks that did not begin within their period.
    """

    def __init__(self, tick_ns: int, now_ns: int) -> None:
        self._tick_ns = tick_ns
        self.due_ns = now_ns + tick_ns
        self.missed = 0

    def begin(self, now_ns: int) -> PacedTick | None:
        """Begin the tick that is due at `now_ns`; return None while none is."""
        late_ns = now_ns - self.due_ns
        if late_ns < 0:
            return None
        elapsed_ticks = 1 + late_ns // self._tick_ns
        self.missed += elapsed_ticks - 1
        self.due_ns += elapsed_ticks * self._tick_ns
        # The loop computes with the due time: then speeds times periods add up to the distance
        # travelled, even where ticks are late.
        return PacedTick(self.due_ns - self._tick_ns, late_ns, elapsed_ticks)


@dataclass(frozen=True, slots=True)
class RealtimeRequest:
    """Settings to request of the operating system.

    fifo: the loop's priority under SCHED_FIFO, 1 to 98. lock: keep memory in RAM. cpus: processors
    that the loop may use; empty for any. slack: fire timers when due. strict: refuse to
    start unless all is granted.
    """

    fifo: int | None = None
    lock: bool = False
    cpus: frozenset[int] = frozenset()
    slack: bool = False
    strict: bool = False


def parse_realtime(text: str | None) -> RealtimeRequest:
    """Parse `fifo=40,lock,cpu=2-3,slack,strict`, or any part of it; None requests nothing.

    `cpu` may come several times. Raises RealtimeError.
    """
    if text is None:
        return RealtimeRequest()
    fifo, cpus, plain = None, set[int](), set[str]()
    for measure in text.split(","):
        name, _, value = (part.strip() for part in measure.partition("="))
        if name == "fifo" and fifo is None:
            fifo = _numbers(value or f"{FIFO_PRIORITY}", 1, MAX_PRIORITY)
            if len(fifo) != 1 or "-" in value:
                raise RealtimeError(
                    f"--realtime: fifo={value:.80}: a priority is 1 to {MAX_PRIORITY}, as fifo=40"
                )
        elif name == "cpu":
            numbers = _numbers(value, 0, MAX_CPU)
            if not numbers:
                raise RealtimeError(
                    f"--realtime: cpu={value:.80}: write one as cpu=1, several as cpu=2-3"
                )
            cpus.update(numbers)
        elif name not in MEASURES:
            raise RealtimeError(
                f"--realtime: unknown measure {name!r:.80}{suggest(name, MEASURES)}"
            )
        elif name == "fifo" or name in plain:
            raise RealtimeError(f"--realtime: {name} is there twice")
        elif value:
            raise RealtimeError(f"--realtime: {name} takes no value, got {value!r:.80}")
        else:
            plain.add(name)
    flags = {name: name in plain for name in ("lock", "slack", "strict")}
    return RealtimeRequest(fifo[0] if fifo else None, cpus=frozenset(cpus), **flags)


def _numbers(text: str, least: int, most: int) -> range:
    """Return the numbers of `3` or `2-4`; none where the text is no range within the bounds."""
    first, dash, last = text.partition("-")
    ends = (first, last if dash else first)
    if not all(end.isascii() and end.isdigit() and len(end) <= 4 for end in ends):
        return range(0)
    low, high = map(int, ends)
    return range(low, high + 1) if least <= low <= high <= most else range(0)


@dataclass(frozen=True, slots=True)
class RefusedSetting:
    """A setting that was requested and not granted, with the reason and advice."""

    name: str
    reason: str
    advice: str

    def __str__(self) -> str:
        return f"real-time: {self.name} is not granted: {self.reason}; {self.advice}"


@dataclass(slots=True)
class RealtimeGrant:
    """Settings in force (name → what was done), and those that were refused."""

    granted: dict[str, str] = field(default_factory=dict)
    refused: list[RefusedSetting] = field(default_factory=list)

    def __str__(self) -> str:
        parts = (f"{name} ({text})" for name, text in self.granted.items())
        return f"real-time: {', '.join(parts) or 'nothing granted'}"


@contextmanager
def apply_realtime(request: RealtimeRequest) -> Iterator[RealtimeGrant]:
    """Apply the requested settings within a `with`, and undo them at its end.

    Call it in the main thread, which runs the loop, after its helper threads have started. Settings
    apply to the calling thread; processes started within the `with` inherit some of them. A
    priority that has to be given up is logged. Raises RealtimeError where a strict request is not
    granted.
    """
    grant, fifo = RealtimeGrant(), f"fifo={request.fifo}"

    def overrun() -> None:
        grant.granted = {
            name + GIVEN_UP if name == fifo else name: text for name, text in grant.granted.items()
        }
        logger.warning(f"real-time: fifo is given up: {LONGEST_RUN_US // 1000} ms without a pause")

    settings: dict[str, AbstractContextManager[str]] = {}
    if request.lock:
        settings["lock"] = lock_memory()
    if request.slack:
        # Set before the priority: under SCHED_FIFO the slack is 0 and cannot be set.
        settings["slack"] = reduce_timer_slack()
    if request.cpus:
        settings[f"cpu={spans(request.cpus)}"] = pin(request.cpus)
    if request.fifo is not None:
        settings[fifo] = schedule_fifo(request.fifo, overrun)
    with ExitStack() as applied:
        for name, setting in settings.items():
            try:
                if sys.platform != "linux":
                    raise NotGrantedError("this system does not have it", "only Linux does")
                grant.granted[name] = applied.enter_context(setting)
            except NotGrantedError as error:
                grant.refused.append(RefusedSetting(name, *error.args))
        if request.strict and grant.refused:
            raise RealtimeError(str(grant.refused[0]))
        yield grant


def check_strict(request: RealtimeRequest) -> None:
    """Check, before a drive moves, that a strict request is granted. Raises RealtimeError."""
    if request.strict:
        with apply_realtime(request):
            pass
