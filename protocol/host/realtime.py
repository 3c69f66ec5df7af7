"""Real-time measures: requested on a command line, held while a loop runs, given back after it.

A request (`RealtimeRequest`) is parsed from text such as "fifo=40,lock,slack". `hold` takes its
measures and yields what was granted and what was refused (`RealtimeGrant`).
"""

import difflib
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field

from protocol.errors import RealtimeError
from protocol.host.measures import (
    LONGEST_RUN_US,
    NotGrantedError,
    lock_memory,
    pin,
    reduce_timer_slack,
    schedule_fifo,
    spans,
)

logger = logging.getLogger(__name__)

MEASURES = ("fifo", "lock", "cpu", "slack")
STRICT = "strict"
# Below 50, at which a PREEMPT_RT kernel runs the threads that bring frames from the network.
FIFO_PRIORITY = 40
# 99 is the kernel's own.
MAX_PRIORITY = 98
MAX_CPU = 4095
GIVEN_UP = " given up"


@dataclass(frozen=True, slots=True)
class RealtimeRequest:
    """Measures to request of the operating system.

    Attributes
    ----------
    fifo : int or None
        The loop's priority under SCHED_FIFO, 1 to 98; None for none.
    lock : bool
        Keep memory in RAM.
    cpus : frozenset of int
        Processors on which alone the loop runs; empty for any.
    slack : bool
        Fire timers when due.
    strict : bool
        Refuse to start unless all is granted.
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
            fifo = _priority(value)
        elif name == "cpu":
            cpus.update(_cpus(value))
        elif name == "gc":
            raise RealtimeError("--realtime: gc is always taken by now: leave it out")
        elif name not in (*MEASURES, STRICT):
            raise RealtimeError(f"--realtime: unknown measure {name!r:.80}{_suggestion(name)}")
        elif name == "fifo" or name in plain:
            raise RealtimeError(f"--realtime: {name} is there twice")
        elif value:
            raise RealtimeError(f"--realtime: {name} takes no value, got {value!r:.80}")
        else:
            plain.add(name)
    return RealtimeRequest(
        fifo=fifo,
        lock="lock" in plain,
        cpus=frozenset(cpus),
        slack="slack" in plain,
        strict=STRICT in plain,
    )


def _priority(value: str) -> int:
    if not value:
        return FIFO_PRIORITY
    if not _is_number(value) or not 1 <= int(value) <= MAX_PRIORITY:
        raise RealtimeError(
            f"--realtime: fifo={value:.80}: a priority is 1 to {MAX_PRIORITY}, as fifo=40"
        )
    return int(value)


def _cpus(value: str) -> range:
    first, dash, last = value.partition("-")
    numbers = [first, last] if dash else [first, first]
    if all(map(_is_number, numbers)):
        low, high = map(int, numbers)
        if low <= high <= MAX_CPU:
            return range(low, high + 1)
    raise RealtimeError(f"--realtime: cpu={value:.80}: write one as cpu=1, several as cpu=2-3")


def _is_number(text: str) -> bool:
    return text.isascii() and text.isdigit() and len(text) <= 4


def _suggestion(name: str) -> str:
    known = (*MEASURES, STRICT)
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean {close[0]}?" if close else f"; known: {', '.join(known)}"


@dataclass(frozen=True, slots=True)
class RefusedMeasure:
    """A measure that was requested and not granted, with the reason and advice."""

    name: str
    reason: str
    advice: str

    def __str__(self) -> str:
        return f"real-time: {self.name} is not granted: {self.reason}; {self.advice}"


@dataclass(slots=True)
class RealtimeGrant:
    """Measures that hold (name → what was done), and those that were refused."""

    granted: dict[str, str] = field(default_factory=dict)
    refused: list[RefusedMeasure] = field(default_factory=list)

    def __str__(self) -> str:
        parts = (f"{name} ({text})" for name, text in self.granted.items())
        return f"real-time: {', '.join(parts) or 'nothing granted'}"


@contextmanager
def hold(request: RealtimeRequest) -> Iterator[RealtimeGrant]:
    """Take the requested measures, and give them back when the `with` ends.

    Call it in the main thread, which runs the loop, once its helper threads run: measures apply to
    the calling thread, and processes started meanwhile inherit some of them.

    A priority that has to be given up is logged.

    Raises
    ------
    RealtimeError
        When the request is strict and a measure is not granted.
    """
    grant = RealtimeGrant()

    def overrun() -> None:
        grant.granted = {
            name + GIVEN_UP if name.startswith("fifo") else name: text
            for name, text in grant.granted.items()
        }
        logger.warning(f"real-time: fifo is given up: {LONGEST_RUN_US // 1000} ms without a pause")

    with ExitStack() as until_the_end:
        for name, measure in _measures(request, overrun).items():
            try:
                if sys.platform != "linux":
                    raise NotGrantedError("this system has no such thing", "Linux has")
                grant.granted[name] = until_the_end.enter_context(measure)
            except NotGrantedError as error:
                grant.refused.append(RefusedMeasure(name, error.reason, error.advice))
        if request.strict and grant.refused:
            raise RealtimeError(str(grant.refused[0]))
        yield grant


def check_strict(request: RealtimeRequest) -> None:
    """Check before anything moves that a strict request is granted. Raises RealtimeError."""
    if request.strict:
        with hold(request):
            pass


def _measures(
    request: RealtimeRequest, overrun: Callable[[], None]
) -> dict[str, AbstractContextManager[str]]:
    """Return the requested measures by name, in the order in which they are taken."""
    measures: dict[str, AbstractContextManager[str]] = {}
    if request.lock:
        measures["lock"] = lock_memory()
    if request.slack:
        # Before a priority, under which the slack is none and cannot be set.
        measures["slack"] = reduce_timer_slack()
    if request.cpus:
        measures[f"cpu={spans(request.cpus)}"] = pin(request.cpus)
    if request.fifo is not None:
        measures[f"fifo={request.fifo}"] = schedule_fifo(request.fifo, overrun)
    return measures
