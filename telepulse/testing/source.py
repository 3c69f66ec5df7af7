"""Conformance of sources whose samples are known in advance."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from protocol.summary.fields import Limits
from protocol.wire.description import Channel, first_repeated
from protocol.wire.messages import LARGEST_N
from sensing_node.sources.source import SampleSource, SourceContext, SourceScene
from telepulse.testing.conformance import call_within, read_table, require

# A source must produce this much stream, far faster than it is played.
STREAM_S = 5.0
WITHIN_S = 2.0
PIECES = (1, 7, 250, 1, 64)


def check_source(
    section: type[SourceScene], keys: Mapping[str, Any], folder: Path | None = None
) -> None:
    """Check a kind of source; paths among its keys count from `folder`, by default the current one.

    Its samples must have the shape of the channels and finite values, whatever the number taken at
    once, and no call may wait.
    """
    table = read_table(section, keys)
    context = SourceContext(Path() if folder is None else folder)

    def build() -> SampleSource:
        return call_within(WITHIN_S, "build", lambda: table.build(context))

    source = build()
    _check_description(source)
    count = round(STREAM_S * 1e9 / source.period_ns)
    taken = _take(source, count)
    _check_values(source, taken)
    _check_pieces(build(), taken)
    if len(taken) < count:
        require(not len(_take(source, 10)), "take returns samples after it had returned fewer")
    notes = source.notes()
    texts = isinstance(notes, list) and all(isinstance(each, str) for each in notes)
    require(texts, f"notes returns {notes!r}, not a list of texts")
    require(isinstance(source.limits(), Limits), "limits returns no Limits")
    ideal = table.ideal().build(context)
    same = (ideal.period_ns, ideal.channels) == (source.period_ns, source.channels)
    require(same, "ideal() has another rate or other channels, so that no error can be computed")


def _check_description(source: SampleSource) -> None:
    period_ns, channels = source.period_ns, source.channels
    require(
        isinstance(period_ns, int) and 1_000 <= period_ns <= 1_000_000_000,
        f"period_ns is {period_ns!r}, not a whole number of ns from 1 µs to 1 s",
    )
    known = isinstance(channels, tuple) and all(isinstance(each, Channel) for each in channels)
    require(known and channels, f"channels is {channels!r}, not a tuple of Channel")
    repeated = first_repeated(each.name for each in channels)
    require(repeated is None, f"two channels have the name {repeated!r}")
    require(not all(each.announces for each in channels), "no channel is a force")
    require(source.group_delay_ns >= 0, "group_delay_ns is negative")


def _take(source: SampleSource, count: int) -> NDArray[np.float64]:
    values = call_within(WITHIN_S, f"take({count})", lambda: source.take(count))
    wanted = (count, len(source.channels))
    require(isinstance(values, np.ndarray), f"take returns {type(values).__name__}, no array")
    require(
        values.ndim == 2 and values.shape[1] == wanted[1] and len(values) <= count,
        f"take({count}) returns the shape {values.shape}, not {wanted}: a column for each channel",
    )
    return values


def _check_values(source: SampleSource, taken: NDArray[np.float64]) -> None:
    require(len(taken), "take returns no sample")
    bad = np.argwhere(~np.isfinite(taken))
    if len(bad):
        row, column = bad[0].tolist()
        value, name = float(taken[row, column]), source.channels[column].name
        require(False, f"sample {row} of channel {name!r} is {value}: each must be finite")
    largest = float(np.abs(taken).max())
    require(
        math.isfinite(largest) and largest <= LARGEST_N,
        f"a sample reaches {largest:.4g} N, and no frame holds more than {LARGEST_N:g} N",
    )


def _check_pieces(source: SampleSource, taken: NDArray[np.float64]) -> None:
    """Check that another source yields the same samples, whatever the number taken at once."""
    position = 0
    for count in PIECES:
        wanted = taken[position : position + count]
        values = _take(source, count)[: len(wanted)]
        same = len(values) == len(wanted) and np.allclose(values, wanted, rtol=1e-9, atol=1e-12)
        require(
            same,
            f"samples from {position} on differ when they are taken {count} at once: a source"
            " must be a function of its table and of the sample's number (seed what is random)",
        )
        position += count
