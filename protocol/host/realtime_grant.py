"""The measures that hold while a loop runs, and those that were not granted."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field, replace

from protocol.errors import RealtimeError
from protocol.host.memory import locked
from protocol.host.realtime_request import RealtimeRequest, spans
from protocol.host.scheduling import (
    LONGEST_RUN_US,
    NotGrantedError,
    first_in_first_out,
    pinned,
    prompt,
)
from protocol.run_summary import Summary

GIVEN_UP = " given up"


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
    """granted: what was done, for people, by the measure's name; refused: what was not."""

    granted: dict[str, str] = field(default_factory=dict)
    refused: list[RefusedMeasure] = field(default_factory=list)

    def noted(self, summary: Summary) -> Summary:
        """Return a loop's summary with the names of the measures that were granted."""
        return replace(summary, loop=replace(summary.loop, realtime=list(self.granted)))

    def __str__(self) -> str:
        parts = (f"{name} ({text})" for name, text in self.granted.items())
        return f"real-time: {', '.join(parts) or 'nothing granted'}"


@contextmanager
def hold(asked: RealtimeRequest, log: Callable[[str], None]) -> Iterator[RealtimeGrant]:
    """Take the measures, and take them back when the `with` ends.

    For the thread that runs the loop, the main thread, once its helpers run: measures are the
    calling thread's, and processes started meanwhile have some of them as well. log is told when a
    priority has to be given up. Raises RealtimeError where all of it was asked for strictly and
    some is not granted.
    """
    held = RealtimeGrant()

    def overrun() -> None:
        held.granted = {
            name + GIVEN_UP if name.startswith("fifo") else name: text
            for name, text in held.granted.items()
        }
        log(f"real-time: fifo is given up: {LONGEST_RUN_US // 1000} ms without a pause")

    with ExitStack() as until_the_end:
        for name, measure in _measures(asked, overrun).items():
            try:
                if sys.platform != "linux":
                    raise NotGrantedError("this system has no such thing", "Linux has")
                held.granted[name] = until_the_end.enter_context(measure)
            except NotGrantedError as error:
                held.refused.append(RefusedMeasure(name, error.reason, error.advice))
        if asked.strict and held.refused:
            raise RealtimeError(str(held.refused[0]))
        yield held


def check_strict(asked: RealtimeRequest) -> None:
    """Find out before anything moves whether a strict wish is granted. Raises RealtimeError."""
    if asked.strict:
        with hold(asked, log=lambda line: None):
            pass


def _measures(
    asked: RealtimeRequest, overrun: Callable[[], None]
) -> dict[str, AbstractContextManager[str]]:
    """Return the requested measures by name, in the order in which they are taken."""
    measures: dict[str, AbstractContextManager[str]] = {}
    if asked.lock:
        measures["lock"] = locked()
    if asked.slack:
        # Before a priority, under which the slack is none and cannot be set.
        measures["slack"] = prompt()
    if asked.cpus:
        measures[f"cpu={spans(asked.cpus)}"] = pinned(asked.cpus)
    if asked.fifo is not None:
        measures[f"fifo={asked.fifo}"] = first_in_first_out(asked.fifo, overrun)
    return measures
