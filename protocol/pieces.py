"""Work in short pieces, for a loop that must be on time. Pure."""

from collections.abc import Generator, Iterator
from typing import TypeVar

Result = TypeVar("Result")


class Pieces:
    """A generator that yields between two pieces of work, or none.

    waiting: whether a piece is still to be done.
    """

    def __init__(self) -> None:
        self._work: Iterator[None] | None = None

    @property
    def waiting(self) -> bool:
        """True until the last piece is done."""
        return self._work is not None

    def begin(self, work: Iterator[None]) -> None:
        """Take work to do; what is left of earlier work is dropped."""
        self._work = work

    def drop(self) -> None:
        """Drop the work that is left."""
        self._work = None

    def do_one(self) -> bool:
        """Do one piece; return whether there was any."""
        work = self._work
        if work is None:
            return False
        try:
            next(work)
        except StopIteration:
            # The last piece has been done. A piece may have begun other work.
            if self._work is work:
                self._work = None
        return True

    def finish(self) -> None:
        """Do all that is left at once."""
        while self.do_one():
            pass


def complete(work: Generator[None, None, Result]) -> Result:
    """Do all pieces at once, and return the work's result."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            result: Result = end.value
            return result
