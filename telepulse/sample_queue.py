"""Samples of a stream in their order, whatever order their frames arrive in. Pure."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.wire.messages import Frame

# A frame is held back for longer than reordering usually delays one; later ones count as lost.
HOLD_NS = 500_000_000
# What is not read within this time is dropped, and counted.
KEPT_S: Final = 60.0


class FrameReorderer:
    """Buffer that holds a frame back while an earlier one may still arrive.

    lost: samples that did not arrive in time.
    """

    def __init__(self) -> None:
        self._held: dict[int, tuple[int, Frame]] = {}
        self._next_sample: int | None = None
        self.lost = 0

    def take(self, frame: Frame, now_ns: int) -> Iterator[Frame]:
        """Add a frame; yield the frames that can be passed on, in order."""
        if self._next_sample is None:
            self._next_sample = frame.first_sample
        if frame.first_sample >= self._next_sample:
            self._held[frame.first_sample] = (now_ns, frame)
        while self._held:
            first = min(self._held)
            if first > self._next_sample and now_ns - self._held[first][0] < HOLD_NS:
                return
            yield self._release(first)

    def flush(self) -> Iterator[Frame]:
        """Yield the frames that are still held."""
        while self._held:
            yield self._release(min(self._held))

    def _release(self, first: int) -> Frame:
        _, frame = self._held.pop(first)
        self.lost += first - (self._next_sample or 0)
        self._next_sample = first + len(frame.values)
        return frame


@dataclass(frozen=True, slots=True, eq=False)
class StreamBlock:
    """Consecutive samples of one session of a stream.

    Attributes
    ----------
    session : int
        Number of the session; another one begins where the sensing node starts again.
    first_sample : int
        Number of the first sample in the session.
    t_ns : ndarray of int, shape (samples,)
        Time at which each sample was taken, on the sensing clock, in ns.
    unix_s : ndarray of float, shape (samples,)
        The same by this machine's clock, as Unix time in s. It follows the present estimate of
        the sensing clock, so that its steps differ slightly at first.
    values : ndarray of float, shape (samples, channels)
        Samples in the units of the channels; NaN where a sample did not arrive.
    """

    session: int
    first_sample: int
    t_ns: NDArray[np.int64]
    unix_s: NDArray[np.float64]
    values: NDArray[np.float64]

    def split(self, count: int) -> tuple["StreamBlock", "StreamBlock"]:
        """Return the first `count` samples, and the others."""
        head, rest = (
            StreamBlock(self.session, first, self.t_ns[part], self.unix_s[part], self.values[part])
            for first, part in (
                (self.first_sample, slice(count)),
                (self.first_sample + count, slice(count, None)),
            )
        )
        return head, rest


class SampleQueue:
    """Queue of samples in their order, without gaps: what is lost is NaN. Pure.

    lost: samples that did not arrive. dropped: samples that were not read in time.
    """

    def __init__(self, kept_s: float = KEPT_S) -> None:
        self._kept_s = kept_s
        self._parts: deque[StreamBlock] = deque()
        self._reorderer = FrameReorderer()
        self._session: int | None = None
        self._next_sample = self._lost = self.dropped = self.waiting = 0

    @property
    def lost(self) -> int:
        """Number of samples that did not arrive."""
        return self._lost

    @property
    def session_ends(self) -> bool:
        """True if the samples that wait belong to more than one session."""
        return len({part.session for part in self._parts}) > 1

    def add(self, frame: Frame, now_ns: int, ahead_ns: int) -> None:
        """Add a frame; ahead_ns: the sensing clock minus Unix time."""
        if frame.session != self._session:
            self.flush(ahead_ns)
            self._session, self._next_sample = frame.session, frame.first_sample
            self._reorderer = FrameReorderer()
        for each in self._reorderer.take(frame, now_ns):
            self._append(each, ahead_ns)

    def flush(self, ahead_ns: int) -> None:
        """Append the frames that wait for earlier ones."""
        for each in self._reorderer.flush():
            self._append(each, ahead_ns)

    def take(self, count: int) -> StreamBlock | None:
        """Return the next samples of one session, at most `count`; None without any."""
        taken: list[StreamBlock] = []
        parts = self._parts
        while count and parts and (not taken or parts[0].session == taken[0].session):
            part = parts.popleft()
            if len(part.values) > count:
                part, rest = part.split(count)
                parts.appendleft(rest)
            taken.append(part)
            count -= len(part.values)
            self.waiting -= len(part.values)
        if not taken:
            return None
        return StreamBlock(
            taken[0].session,
            taken[0].first_sample,
            np.concatenate([part.t_ns for part in taken]),
            np.concatenate([part.unix_s for part in taken]),
            np.concatenate([part.values for part in taken]),
        )

    def _append(self, frame: Frame, ahead_ns: int) -> None:
        most = round(self._kept_s * 1e9 / frame.period_ns)
        missing = frame.first_sample - self._next_sample
        self._lost += missing
        at = np.arange(-min(missing, most), len(frame.values))
        t_ns = frame.t_first_ns + at.astype(np.int64) * frame.period_ns
        unix_s = (t_ns - ahead_ns).astype(np.float64) * 1e-9
        values = np.full((len(at), frame.values.shape[1]), np.nan)
        values[len(at) - len(frame.values) :] = frame.values
        first = frame.first_sample + int(at[0])
        self._parts.append(StreamBlock(frame.session, first, t_ns, unix_s, values))
        self.waiting += len(at)
        self._next_sample = frame.first_sample + len(frame.values)
        while self.waiting > most:
            oldest = self._parts.popleft()
            gone, rest = oldest.split(min(len(oldest.values), self.waiting - most))
            self.dropped += len(gone.values)
            self.waiting -= len(gone.values)
            if len(rest.values):
                self._parts.appendleft(rest)
