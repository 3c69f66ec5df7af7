"""The state of a display's last tick, blocks of ticks, and the counter of a limit. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from struct import Struct
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.summary.fields import Limited

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]
# `TickState.predicted_ns` of a tick in which no instant of the pulse is played.
NOT_PLAYED: Final = -1
# A tick in an array has the number of the display's state.
DISPLAY_STATES: Final = ("waiting", "starting", "playing", "stale", "ended", "fault")


@dataclass(slots=True)
class TickState:
    """State of one contactor at the beginning of the last tick.

    `Playout` sets the times and trusted, the contactor the forces and full, `Display` the rest.

    now_ns, sensing_now_ns: time of the tick on the display's clock and on the sensing clock.
    instant_ns: instant of the pulse that is played, on the sensing clock. Where none is played,
    only now_ns is of this tick. target_n: force in N that the finger is to feel now: the reference
    within its bounds, as late as the loop makes it.
    felt_n: force in N that it feels, NaN where a real film gives none. full: the pulse is felt at
    full strength. predictor_error_n: expected RMSE of the prediction in N, NaN without a prediction
    or an estimate. trusted: the predictor is trusted with all of the delay.

    The first contactor's has the rest for the whole display. press_n, hold_down_n: static force in
    N of the finger, and of the probe on the wrist as last reported; NaN without. predicted_ns: time
    from the newest sample to the played instant; 0 for a received one, `NOT_PLAYED` where none is
    played (the playout sets it as well). elapsed_ticks: since the tick before.
    """

    now_ns: int = 0
    sensing_now_ns: int = 0
    instant_ns: int = 0
    target_n: float = 0.0
    felt_n: float = 0.0
    full: bool = False
    predictor_error_n: float = math.nan
    trusted: bool = False
    press_n: float = math.nan
    hold_down_n: float = math.nan
    predicted_ns: int = NOT_PLAYED
    display_state: str = "waiting"
    elapsed_ticks: int = 1

    @property
    def playout_delay_ns(self) -> int:
        """The perceived delay E of this tick."""
        return self.sensing_now_ns - self.instant_ns


# A tick's fields, and those of one contactor in it.
_TICK, _FORCES = Struct("<8q2d"), Struct("<3d")


class TickColumns(NamedTuple):
    """Integers of consecutive ticks, one value a tick; display_state: place in `DISPLAY_STATES`."""

    now_ns: Integers
    instant_ns: Integers
    full: Integers
    trusted: Integers
    sensing_now_ns: Integers
    predicted_ns: Integers
    display_state: Integers
    elapsed_ticks: Integers


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
            state.full,
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
    def columns(self) -> TickColumns:
        """The fields of `TickState` that are integers."""
        return TickColumns(*self._integers[: self.count, :8].T)

    @property
    def press_n(self) -> Floats:
        """Press and hold-down, shape (ticks, 2)."""
        return self._floats[: self.count, 8:10]

    @property
    def forces_n(self) -> Floats:
        """Target, felt force and predictor's error of each contactor in turn, a row a tick."""
        return self._floats[: self.count, 10:]

    def felt_n(self, contactor: int) -> Floats:
        """Return the felt force at a contactor, by its place."""
        return self.forces_n[:, 3 * contactor + 1]


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
