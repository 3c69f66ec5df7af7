"""Columns of a run: the samples and the ticks of each session, simulated or recorded; a table."""

import struct
from array import array
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, get_type_hints

import numpy as np
from numpy.typing import NDArray

from protocol.errors import OutputError
from protocol.wire.description import StreamDescription
from protocol.wire.messages import Frame
from protocol.wire.telemetry import PlaybackStatus

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
# Sensing clock of a tick at which it was unknown. No sample is of that time.
UNKNOWN_NS = -(1 << 62)
_CODES = {int: "q", float: "d", bool: "?"}


class FrameRow(NamedTuple):
    """A frame without its values. Times in ns.

    samples: their number. ticks: number of the session's ticks before it. unix_ahead_ns: Unix time
    minus the sensing clock at its arrival.
    """

    first_sample: int
    t_first_ns: int
    period_ns: int
    samples: int
    ticks: int
    unix_ahead_ns: int


class TickRow(NamedTuple):
    """A tick without the forces of its contactors. Times in ns.

    sensing_ns: `UNKNOWN_NS` where the sensing clock is unknown. ready: the stream's usual delay is
    known as well. playing: the pulse of `instant_ns` was played. full: at full strength.
    predicted: before its sample had arrived. press_n: of the finger that presses back, NaN without
    one.
    """

    now_ns: int
    sensing_ns: int
    instant_ns: int
    ready: bool
    playing: bool
    full: bool
    predicted: bool
    unix_ns: int = 0
    press_n: float = np.nan


class Rows:
    """A growing table of numbers, with a column for each field of a NamedTuple."""

    def __init__(self, kind: type[Any]) -> None:
        codes = {name: _CODES[hint] for name, hint in get_type_hints(kind).items()}
        self._dtype = np.dtype(list(codes.items()))
        self._pack = struct.Struct("=" + "".join(codes.values())).pack
        self._data = bytearray()

    def __len__(self) -> int:
        return len(self._data) // self._dtype.itemsize

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return a column."""
        return np.frombuffer(self._data, self._dtype)[name].copy()

    def add(self, row: tuple[Any, ...]) -> None:
        """Add a row. Raises ValueError for a number of another type, or beyond 64 bits."""
        try:
            self._data += self._pack(*row)
        except struct.error as error:
            raise ValueError(str(error)) from None


class SessionColumns:
    """Samples and ticks of one session of the sensing node, each in the order of arrival.

    number: of the session. description: of its stream; None where it is unknown. playing: how each
    contactor plays it, by name and in the display's order; empty where it is unknown.
    """

    def __init__(self, number: int = 0, description: StreamDescription | None = None) -> None:
        self.number, self.description = number, description
        self.playing: dict[str, PlaybackStatus] = {}
        self.frames, self.ticks = Rows(FrameRow), Rows(TickRow)
        self._values = bytearray()
        self._dtype, self._channels = np.dtype("<f4"), 1
        # Target and felt force of each contactor; a contactor that appears later has gaps before.
        self._forces: list[tuple[array[float], array[float]]] = []

    def add_frame(self, frame: Frame, unix_ahead_ns: int = 0) -> None:
        """Add a frame of the session, whose frames have the same channels and number format."""
        _, first_sample, t_first_ns, period_ns, values = frame
        counts = len(values), len(self.ticks)
        self.frames.add(FrameRow(first_sample, t_first_ns, period_ns, *counts, unix_ahead_ns))
        self._dtype, self._channels = values.dtype, values.shape[1]
        self._values += values.tobytes()

    def add_tick(self, tick: TickRow, forces_n: Sequence[Sequence[float]]) -> None:
        """Add a tick; forces_n: target and felt force of each contactor."""
        while len(self._forces) < len(forces_n):
            gap = [np.nan] * len(self.ticks)
            self._forces.append((array("d", gap), array("d", gap)))
        for number, (target_n, felt_n) in enumerate(self._forces):
            target, felt = forces_n[number] if number < len(forces_n) else (np.nan, np.nan)
            target_n.append(target)
            felt_n.append(felt)
        self.ticks.add(tick)

    def forces_n(self, contactor: str) -> tuple[Floats, Floats]:
        """Return target and felt force of a contactor at each tick; NaN where it plays none."""
        recorded = dict(zip(self.playing, self._forces, strict=False))
        if contactor not in recorded:
            missing = np.full(len(self.ticks), np.nan)
            return missing, missing
        target_n, felt_n = recorded[contactor]
        return np.array(target_n), np.array(felt_n)

    @property
    def values(self) -> NDArray[Any]:
        """Samples of all frames, shape (samples, channels)."""
        return np.frombuffer(bytes(self._values), self._dtype).reshape(-1, self._channels)

    def each_frame(self) -> Iterator[Frame]:
        """Yield the frames as they arrived."""
        values, end = self.values, 0
        names = ("first_sample", "t_first_ns", "period_ns", "samples")
        for first, t_ns, period_ns, samples in zip(
            *(self.frames[name].tolist() for name in names), strict=True
        ):
            end += samples
            yield Frame(self.number, first, t_ns, period_ns, values[end - samples : end])

    def pulse_ns(self) -> Ints:
        """Return the time of the pulse that each sample shows, on the sensing clock.

        It is earlier than the sample by the sensing chain's group delay.
        """
        samples = self.frames["samples"]
        within = np.arange(samples.sum()) - np.repeat(np.cumsum(samples) - samples, samples)
        t_ns = np.repeat(self.frames["t_first_ns"], samples)
        t_ns += within * np.repeat(self.frames["period_ns"], samples)
        return t_ns - (0 if self.description is None else self.description.group_delay_ns)

    def pulse(self, channel: int) -> tuple[Ints, Floats]:
        """Return the times of the pulse in their order, and a channel's force at each."""
        t_ns = self.pulse_ns()
        force_n = self.values[:, channel if len(t_ns) else 0].astype(np.float64)
        if (t_ns[1:] < t_ns[:-1]).any():
            order = np.argsort(t_ns, kind="stable")
            t_ns, force_n = t_ns[order], force_n[order]
        return t_ns, force_n


def join_ticks(sessions: Sequence[SessionColumns], column: str) -> NDArray[Any]:
    """Return a column of the ticks of several sessions."""
    return np.concatenate([session.ticks[column] for session in sessions])


def data_frame(columns: Mapping[str, Any]) -> "pd.DataFrame":
    """Return columns as a pandas DataFrame. Raises OutputError without pandas."""
    try:
        import pandas as pd
    except ImportError as error:
        raise OutputError(
            f"to_dataframe needs pandas, which cannot be loaded ({error});"
            " pip install 'telepulse[analysis]'"
        ) from None
    return pd.DataFrame(columns)
