"""The state of a display's last tick, blocks of ticks, and counters of them. Pure.

The counters give the figures of `protocol.summary.tables`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from protocol.summary.tables import STATES, Availability, Interruptions, Limited

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
# A tick in an array has the number of the display's state.
DISPLAY_STATES: Final = ("waiting", "starting", "playing", "stale", "ended", "fault")


@dataclass(slots=True)
class TickState:
    """State at the beginning of the last tick; `Trace` explains the fields that it shares.

    The first contactor's has the last three for the whole display. predicted_ns: time from the
    newest sample to the played instant; 0 for a received one, negative where none is played.
    elapsed_ticks: since the tick before.
    """

    now_ns: int = 0
    sensing_now_ns: int = 0
    instant_ns: int = 0
    target_n: float = 0.0
    felt_n: float = 0.0
    scored: bool = False
    predictor_error_n: float = math.nan
    trusted: bool = False
    press_n: float = math.nan
    hold_down_n: float = math.nan
    predicted_ns: int = -1
    display_state: str = "waiting"
    elapsed_ticks: int = 1

    @property
    def playout_delay_ns(self) -> int:
        """The perceived delay E of this tick."""
        return self.sensing_now_ns - self.instant_ns


# A tick's fields, and those of one contactor in it.
_TICK, _FORCES = Struct("<8q2d"), Struct("<3d")


class TickBlock:
    """Consecutive ticks of a display, in an array that is allocated once: one row a tick.

    contactors: number of states that a tick has. most: number of rows. count: ticks so far; with 0
    the next block begins, which overwrites the arrays of this one.
    """

    def __init__(self, contactors: int, most: int) -> None:
        self._row_bytes = _TICK.size + contactors * _FORCES.size
        self._rows = bytearray(most * self._row_bytes)
        # Two views of the same rows.
        self._integers: Integers = np.frombuffer(self._rows, "<i8").reshape(most, -1)
        self._floats: Floats = np.frombuffer(self._rows, "<f8").reshape(most, -1)
        self.most, self.count = most, 0

    def add(self, states: Sequence[TickState]) -> None:
        """Add a tick, of which each contactor has a state."""
        # Arguments one by one: a row that is built first takes twice the time.
        rows, at, state = self._rows, self.count * self._row_bytes, states[0]
        _TICK.pack_into(
            rows,
            at,
            state.now_ns,
            state.instant_ns,
            state.scored,
            state.trusted,
            state.sensing_now_ns,
            state.predicted_ns,
            DISPLAY_STATES.index(state.display_state),
            state.elapsed_ticks,
            state.press_n,
            state.hold_down_n,
        )
        at += _TICK.size
        for state in states:
            _FORCES.pack_into(rows, at, state.target_n, state.felt_n, state.predictor_error_n)
            at += _FORCES.size
        self.count += 1

    @property
    def columns(self) -> Integers:
        """The fields of `TickState` that are integers, shape (8, ticks), in the order of `add`."""
        return self._integers[: self.count, :8].T

    @property
    def forces_n(self) -> Floats:
        """Press, hold-down, and of each contactor target, felt force and predictor's error."""
        return self._floats[: self.count, 8:]

    def felt_n(self, contactor: int) -> Floats:
        """Return the felt force at a contactor, by its place."""
        return self._floats[: self.count, 11 + 3 * contactor]


# A display's state → the key that it is counted under, if that differs.
_KEYS = {"playing": "felt", "fault": "faulted"}


class AvailabilityCounter:
    """Counter of a display's ticks by its state."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._ticks = np.zeros(len(DISPLAY_STATES), np.int64)
        self._all = 0

    def add(self, states: Integers, elapsed_ticks: Integers) -> None:
        """Count ticks by the numbers of their states, each some ticks after the one before."""
        self._ticks += np.bincount(states, minlength=len(DISPLAY_STATES))
        self._all += int(elapsed_ticks.sum())

    def availability(self, played_ticks: int) -> Availability:
        """Return the shares so far; played_ticks: number of ticks in which a pulse was played."""
        if not self._all:
            return Availability()
        counts = self._ticks.tolist()
        keys = (_KEYS.get(state, state) for state in DISPLAY_STATES)
        ticks = dict(zip(keys, counts, strict=True))
        ticks |= {"missed": self._all - sum(counts), "played": played_ticks}
        shares = {key: ticks.get(key, 0) / self._all for key in (*STATES, "played")}
        return Availability(self._all * self._tick_s, **shares)


class InterruptionCounter:
    """Counter of a run's interruptions."""

    def __init__(self, tick_s: float) -> None:
        self._tick_s = tick_s
        self._ticks = self._count = self._interrupted_ticks = self._longest = 0
        # The last tick at full strength, and whether a tick below full strength followed.
        self._full: int | None = None
        self._interrupted = False
        self._last: tuple[int, int] | None = None

    def add(self, full: Integers, elapsed_ticks: Integers) -> None:
        """Count ticks, at full strength or not, each some ticks after the one before."""
        numbers = self._ticks + elapsed_ticks.cumsum()
        self._ticks = int(numbers[-1])
        if full.all() and not self._interrupted:
            self._full = self._ticks
            return
        # Stretches of ticks that are all at full strength, or are not.
        ends = np.append(full[1:] != full[:-1], True).nonzero()[0]
        firsts = numbers[np.append(0, ends[:-1] + 1)].tolist()
        stretches = zip(full[ends].tolist(), firsts, numbers[ends].tolist(), strict=True)
        for is_full, first, last in stretches:
            if not is_full:
                self._interrupted = self._full is not None
                continue
            if self._interrupted and self._full is not None:
                self._interrupted = False
                self._last = self._full, first
                ticks = first - self._full
                self._count += 1
                self._interrupted_ticks += ticks
                self._longest = max(self._longest, ticks)
            self._full = last

    def interruptions(self) -> Interruptions:
        """Return the interruptions so far."""
        if not self._ticks:
            return Interruptions()
        if self._last is None:
            return Interruptions(0, 0.0)
        seconds = (
            ticks * self._tick_s for ticks in (self._interrupted_ticks, self._longest, *self._last)
        )
        return Interruptions(self._count, *seconds)


class LimitCounter:
    """Counter of the ticks (or samples) at a limit, and of the times it was reached.

    active: whether the last tick was at the limit. While it is False, `add(False)` changes nothing.
    """

    __slots__ = ("active", "ticks", "times")

    def __init__(self) -> None:
        self.active = False
        self.ticks = self.times = 0

    def add(self, limited: bool, ticks: int = 1) -> None:
        """Count `ticks` ticks that were all at the limit, or were not."""
        if limited:
            self.ticks += ticks
            self.times += not self.active
        self.active = limited

    def add_all(self, limited: NDArray[np.bool_]) -> None:
        """Count consecutive ticks or samples, shape (n,)."""
        if len(limited):
            self.ticks += int(np.count_nonzero(limited))
            before = np.concatenate([[self.active], limited[:-1]])
            self.times += int(np.count_nonzero(limited & ~before))
            self.active = bool(limited[-1])

    def limited(self, period_s: float, total_ticks: int) -> Limited:
        """Return the figures so far, of `total_ticks` ticks or samples of a period in s."""
        share = self.ticks / total_ticks if total_ticks else 0.0
        return Limited(self.times, self.ticks * period_s, share)
