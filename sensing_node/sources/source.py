"""The interface of sources whose samples are known in advance, and the kinds of them.

To add a kind: write a `SourceScene` and the `SampleSource` that it builds, and name the former in
`SOURCES`, or in an entry point of another distribution (`docs/howto/plugins.md`).
"""

from abc import ABC, abstractmethod
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from protocol.config.kinds import KindGroup, KindTable
from protocol.summary.fields import Limits
from protocol.wire.description import Channel
from sensing_node.press.probe import ProbeLimits
from sensing_node.press.set_points import PressedProbe


class SampleSource(ABC):
    """A source whose samples are known in advance.

    Attributes
    ----------
    period_ns : int
        Time between samples.
    channels : tuple of Channel
        Channels of the columns.
    group_delay_ns : int
        Delay of the pulse in the samples, against the force at the wrist.
    repeats_after_s : float or None
        Length in s of what is played again and again; None for a source that does not repeat.
    """

    period_ns: int
    channels: tuple[Channel, ...]
    group_delay_ns: int = 0
    repeats_after_s: float | None = None

    @abstractmethod
    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next samples in N, shape (at most count, channels); fewer only at the end.

        Never waits: the caller releases samples when they are due.
        """

    @property
    def rejected(self) -> Counter[str]:
        """Count of data that could not be used, by cause."""
        return Counter()

    def notes(self) -> list[str]:
        """Return what is doubtful in the samples so far, one line each, for the summary."""
        return []

    def limits(self) -> Limits:
        """Return how often the source's own limits have bounded the samples, for the summary."""
        return Limits()

    @property
    def pressed(self) -> PressedProbe | None:
        """The probe that takes set-points; None where none presses."""
        return None


@dataclass(frozen=True, slots=True)
class SourceContext:
    """Context of a source, besides its own table.

    folder: of the scene's file. plausible: refuse samples that cannot be a pulse. press: limits of
    the probe, where the scene has one.
    """

    folder: Path
    plausible: bool = True
    press: ProbeLimits | None = None


class SourceScene(KindTable):
    """Base of the `source` tables whose samples are known in advance.

    pressable: a probe presses this source, so that the scene needs a table [sensing.press].
    """

    pressable: ClassVar[bool] = False

    @abstractmethod
    def build(self, context: SourceContext) -> SampleSource:
        """Build the source. Raises SourceError for a file that cannot be used."""

    def ideal(self) -> Self:
        """Return the table without what a measurement adds to the true force."""
        return self

    def with_seed(self, seed: int) -> Self:
        """Return the table with another seed; the same table where nothing is random."""
        return self

    def still(self) -> "SourceScene | None":
        """Return the table without its pulse; None where it has no such setting."""
        return None


SOURCES = KindGroup(
    "telepulse.sources",
    "source",
    SourceScene,
    {
        "synthetic": "sensing_node.sources.synthetic:SyntheticScene",
        "recording": "sensing_node.sources.recorded:RecordingScene",
        "wrist": "sensing_node.sources.wrist:WristScene",
    },
)
