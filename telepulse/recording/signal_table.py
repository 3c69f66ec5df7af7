"""A recording's forces as signals of one rate, which a writer of a format takes."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Annotation(NamedTuple):
    """An annotation: seconds after the begin, text, and its length in s if it has one."""

    at_s: float
    text: str
    length_s: float | None = None


class SignalTable(NamedTuple):
    """Signals of one rate; their names differ.

    values: shape (samples, signals), whole seconds, NaN where missing. begin_ns: Unix time of the
    first sample. about: what a person stated about the recording, by key.
    """

    names: Sequence[str]
    units: Sequence[str]
    values: Floats
    rate_hz: int
    begin_ns: int
    annotations: Sequence[Annotation] = ()
    about: Mapping[str, str] = {}

    @property
    def begin(self) -> datetime:
        """The begin in UTC, in whole microseconds."""
        return datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=self.begin_ns // 1000)


class SignalWriter(Protocol):
    """A format's writer."""

    def __call__(self, path: Path, table: SignalTable) -> list[str]:
        """Write a new file; return a line on each thing that it does not hold, or rounds.

        Raises OSError, and ValueError for signals that the format cannot hold.
        """


def plain_micro(text: str) -> str:
    """Return a text with u for each sign of micro, which ASCII lacks."""
    return text.replace("\N{MICRO SIGN}", "u").replace("\N{GREEK SMALL LETTER MU}", "u")
