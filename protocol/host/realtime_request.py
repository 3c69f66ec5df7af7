"""Real-time measures requested of the operating system, parsed from a command line."""

import difflib
from dataclasses import dataclass

from protocol.errors import RealtimeError

MEASURES = ("fifo", "lock", "cpu", "slack")
STRICT = "strict"
# Under 50, at which a PREEMPT_RT kernel runs the threads that bring frames from the network.
FIFO_PRIORITY = 40
# 99 is the kernel's own.
MAX_PRIORITY = 98
MAX_CPU = 4095


@dataclass(frozen=True, slots=True)
class RealtimeRequest:
    """fifo: the loop's priority under SCHED_FIFO, None for none; lock: memory stays in RAM; cpus:
    the loop runs on these alone, empty for any; slack: timers are not put off; strict: all of it,
    or no start."""

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
    for word in text.split(","):
        name, _, value = (part.strip() for part in word.partition("="))
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


def spans(cpus: frozenset[int]) -> str:
    """Processors as a command line names them: `0-1`, and `0-1, 3` where there is a gap."""
    starts = sorted(cpu for cpu in cpus if cpu - 1 not in cpus)
    ends = sorted(cpu for cpu in cpus if cpu + 1 not in cpus)
    pairs = zip(starts, ends, strict=True)
    return ", ".join(f"{a}" if a == b else f"{a}-{b}" for a, b in pairs)


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
