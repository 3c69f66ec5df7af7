"""The jitter buffer: one session's samples in time order, and the account of each of them.

All times are on the sensing clock. `advance` plays the samples up to a time. A sample that is in
the buffer when its time passes was played. One that arrives later counts as predicted if a trusted
prediction was felt in its place, and as late otherwise; one that never arrives is lost. Samples
that arrive later are kept as well: after a jump back of the playout they are played.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace
from operator import add
from typing import Final

from protocol.errors import WireError
from protocol.summary.fields import SampleCounts

# Settled samples that are kept, and the number that is removed at once: in 0.1 ms, not in 1 ms.
KEEP_SAMPLES: Final = 16_384
TRIM_SAMPLES: Final = 1_024
MAX_AHEAD_SAMPLES: Final = 65_536
TIME_TOLERANCE_NS: Final = 1_000_000_000
NEVER_NS: Final = -(1 << 64)


@dataclass(frozen=True, slots=True)
class SampleAccount:
    """sent = played + predicted + late + lost, of the samples whose time has passed."""

    sent: int = 0
    played: int = 0
    predicted: int = 0
    late: int = 0
    before_joining: int = 0

    @property
    def lost(self) -> int:
        """Samples that never arrived."""
        return self.sent - self.played - self.predicted - self.late

    def counts(self) -> SampleCounts:
        """Return the figures of the account."""
        return SampleCounts(self.sent, self.played, self.predicted, self.late, self.lost)

    def __add__(self, other: "SampleAccount") -> "SampleAccount":
        return SampleAccount(*map(add, astuple(self), astuple(other)))


@dataclass(slots=True)
class _Arrivals:
    """Samples that arrived after the buffer had passed their time, as a contactor met them.

    in_time: those that arrived before the contactor had passed it.
    """

    in_time: int = 0
    predicted: int = 0
    late: int = 0


class JitterBuffer:
    """One session's samples, of one channel or several.

    Parameters
    ----------
    channel_count
        Number of channels that are kept.
    begin_index
        Number of the first sample that counts, if another buffer has counted those before it.

    Attributes
    ----------
    newest_ns
        Time of the newest sample; None while there is none.
    frames, reordered
        Number of frames taken, and of those that came after a newer one; a receiver adds those of
        the buffers before this one.
    ended
        Whether the session's end is known.
    """

    def __init__(self, channel_count: int = 1, begin_index: int | None = None) -> None:
        self._joining = begin_index is None
        self._indices: list[int] = []
        self._times: list[int] = []
        # Of each channel.
        self._forces_n: list[list[float]] = [[] for _ in range(channel_count)]
        # The time of the samples before this list position has passed.
        self._settled = 0
        # The latest time ever played; it stays when the playout jumps back.
        self._passed_ns = NEVER_NS
        # Whether a trusted prediction is felt where no sample has arrived, and the times after
        # which this changed, at first to True.
        self._trusted = False
        self._changed_ns: list[int] = []
        self._first_index = begin_index
        self._floor_index = begin_index or 0
        self._period_ns = 1
        self._end_index: int | None = None
        self._played = self._predicted = self._late = 0
        # Lag of each contactor of `keep_accounts`, and the accounts by lag. Without a lag, the
        # account is the buffer's own.
        self._lags_ns: list[int] = []
        self._arrivals: dict[int, _Arrivals] = {}
        self.newest_ns: int | None = None
        self.frames = self.reordered = 0
        self.ended = False

    @property
    def waiting(self) -> int:
        """Samples that wait for their time."""
        return len(self._times) - self._settled

    def put(
        self,
        first_sample: int,
        period_ns: int,
        times_ns: list[int],
        forces_n: Sequence[Sequence[float]],
    ) -> None:
        """Take a frame: the times of its samples, and their forces in N on each channel.

        Raises WireError: "duplicate", "overlap", "timestamp", "too_old", "overflow".
        """
        indices, times, count = self._indices, self._times, len(times_ns)
        place = len(indices)
        # Frames seldom come late, and a search reads memory that is no longer in a cache.
        late = place > 0 and first_sample <= indices[-1]
        if late:
            place = self._place(first_sample, period_ns, times_ns)
        if place:
            gap_ns = times_ns[0] - times[place - 1]
            expected_ns = (first_sample - indices[place - 1]) * period_ns
            # Most are equal, and a call takes longer than this comparison.
            if gap_ns != expected_ns:
                _check_gap(gap_ns, expected_ns)
        elif first_sample < self._floor_index:
            raise WireError("too_old", f"sample {first_sample} is older than the buffer reaches")
        if len(times) - self._settled + count > MAX_AHEAD_SAMPLES:
            raise WireError("overflow", f"more than {MAX_AHEAD_SAMPLES} samples wait already")
        indices[place:place] = range(first_sample, first_sample + count)
        times[place:place] = times_ns
        for kept_n, new_n in zip(self._forces_n, forces_n, strict=True):
            kept_n[place:place] = new_n
        self.newest_ns = times[-1]
        self._period_ns = period_ns
        self.frames += 1
        self.reordered += late
        if self._first_index is None or first_sample < self._first_index:
            self._first_index = first_sample
        if times_ns[0] <= self._passed_ns:
            passed = bisect_right(times_ns, self._passed_ns)
            predicted = self._trusted_among(times_ns[:passed])
            self._predicted += predicted
            self._late += passed - predicted
            self._settled += passed
            for lag_ns, arrivals in self._arrivals.items():
                self._judge(times_ns[:passed], lag_ns, arrivals)
        if self._settled >= KEEP_SAMPLES + TRIM_SAMPLES:
            self._trim()

    def _place(self, first_sample: int, period_ns: int, times_ns: list[int]) -> int:
        """Return the place of samples before newer ones. Raises WireError as `put` does."""
        indices, count = self._indices, len(times_ns)
        place, last = bisect_left(indices, first_sample), first_sample + count - 1
        newer = indices[place]
        if newer <= last:
            all_here = indices[place + count - 1 : place + count] == [last]
            cause = "duplicate" if all_here else "overlap"
            raise WireError(cause, f"sample {newer} is here already")
        _check_gap(self._times[place] - times_ns[-1], (newer - last) * period_ns)
        return place

    def keep_accounts(self, lags_ns: Sequence[int]) -> None:
        """Keep an account for each of several contactors as well. Call before the first sample.

        lags_ns: time in ns by which each plays a sample after `advance` has passed it.
        """
        self._lags_ns = list(lags_ns)
        self._arrivals = {lag_ns: _Arrivals() for lag_ns in lags_ns if lag_ns}

    def _judge(self, times: list[int], lag_ns: int, arrivals: _Arrivals) -> None:
        """Count samples that arrived after the buffer had passed them by a contactor's own time."""
        passed = bisect_right(times, self._passed_ns - lag_ns)
        arrivals.in_time += len(times) - passed
        if passed:
            # The trust changes for a later contactor's samples when it changes for the first's.
            predicted = self._trusted_among([t_ns + lag_ns for t_ns in times[:passed]])
            arrivals.predicted += predicted
            arrivals.late += passed - predicted

    def _trusted_among(self, times: list[int]) -> int:
        """Return how many times that have passed were felt from a trusted prediction."""
        changed_ns = self._changed_ns
        if not changed_ns or times[0] > changed_ns[-1]:
            return len(times) if self._trusted else 0
        return sum(bisect_left(changed_ns, t_ns) % 2 for t_ns in times)

    def _trim(self) -> None:
        """Remove the oldest settled samples; earlier ones are refused from then on."""
        surplus = self._settled - KEEP_SAMPLES
        self._floor_index = self._indices[surplus - 1] + 1
        del self._indices[:surplus], self._times[:surplus]
        for values in self._forces_n:
            del values[:surplus]
        self._settled = KEEP_SAMPLES
        # Removal in pairs keeps the first change one to True.
        forgotten = bisect_left(self._changed_ns, self._times[0]) // 2 * 2
        del self._changed_ns[:forgotten]

    def advance(self, sampled_ns: int, trusted: bool = False) -> None:
        """Play the samples up to a time, which settles them.

        trusted: whether a trusted prediction is felt where no sample has come.
        After the playout jumps back, settled samples stay settled and are returned by `known`
        again.
        """
        if sampled_ns <= self._passed_ns:
            return
        if trusted != self._trusted:
            self._trusted = trusted
            self._changed_ns.append(self._passed_ns)
        self._passed_ns = sampled_ns
        settled = bisect_right(self._times, sampled_ns, self._settled)
        self._played += settled - self._settled
        self._settled = settled

    def known(
        self, step_ns: int, count: int, begin_ns: int, places: Sequence[int]
    ) -> list[list[float]]:
        """Return `count` values of each of some channels, `step_ns` apart.

        They are interpolated linearly. The lists end at the newest sample, and are empty before the
        first one. begin_ns: time of the first value, not after the played one. places: of the
        channels among those that are kept, from 0.
        """
        times, position, t_ns = self._times, self._settled, begin_ns
        length = len(times)
        if t_ns < self._passed_ns:
            position = bisect_right(times, t_ns)
        if not position:
            return [[] for _ in places]
        values, several, at_newest = self._forces_n[places[0]], len(places) > 1, False
        result: list[float] = []
        # Positions and shares, which are the same for all channels.
        between: list[tuple[int, float]] = []
        for _ in range(count):
            while position < length and times[position] <= t_ns:
                position += 1
            before_ns = times[position - 1]
            if position == length:
                if before_ns == t_ns:
                    at_newest = True
                    result.append(values[-1])
                break
            share = (t_ns - before_ns) / (times[position] - before_ns)
            before = values[position - 1]
            result.append(before + share * (values[position] - before))
            if several:
                between.append((position, share))
            t_ns += step_ns
        results = [result]
        for place in places[1:] if several else ():
            values = self._forces_n[place]
            result = []
            for position, share in between:
                before = values[position - 1]
                result.append(before + share * (values[position] - before))
            if at_newest:
                result.append(values[-1])
            results.append(result)
        return results

    def end(self, samples_sent: int, now_ns: int | None) -> None:
        """End the session after `samples_sent` samples; those that are missing count as lost.

        now_ns: time on the sensing clock, if known. Raises WireError("implausible") where there was
        no time for that number of samples, or more have come.
        """
        if self._indices:
            missing = samples_sent - 1 - self._indices[-1]
            if missing < 0:
                raise WireError("implausible", f"the end at {samples_sent} is before the newest")
            room_ns = TIME_TOLERANCE_NS + (now_ns or self._times[-1]) - self._times[-1]
            if missing * self._period_ns > room_ns:
                raise WireError("implausible", f"no time for {missing} further samples")
        self._end_index = samples_sent
        self.ended = True

    @property
    def end_ns(self) -> int | None:
        """Time of the session's last sample, once its end is known."""
        if self._end_index is None or not self._times:
            return None
        return self._times[-1] + (self._end_index - 1 - self._indices[-1]) * self._period_ns

    @property
    def complete(self) -> bool:
        """True once the session's last sample has arrived."""
        return bool(self._indices) and self._indices[-1] + 1 == self._end_index

    def account(self) -> SampleAccount:
        """Return the account so far; of the whole session once it has ended and played out."""
        first = self._first_index
        if first is None:
            return SampleAccount(before_joining=self._end_index or 0)
        settled_end = self._indices[self._settled - 1] + 1 if self._settled else first
        if self._end_index is not None and not self.waiting:
            settled_end = max(settled_end, self._end_index)
        before_joining = first if self._joining else 0
        sent = settled_end - first
        return SampleAccount(sent, self._played, self._predicted, self._late, before_joining)

    def accounts(self) -> list[SampleAccount]:
        """Return the account of each contactor that `keep_accounts` names.

        Samples within its lag count as played, although their time is still to come.
        """
        whole = self.account()
        accounts = {
            lag_ns: replace(
                whole,
                played=whole.played + each.in_time,
                predicted=each.predicted,
                late=each.late,
            )
            for lag_ns, each in self._arrivals.items()
        }
        return [accounts.get(lag_ns, whole) for lag_ns in self._lags_ns]

    def successor(self) -> "JitterBuffer":
        """Return an empty buffer that continues the account after the last settled sample.

        Waiting samples are lost, and so are earlier ones that come later.
        """
        first = self._first_index
        begin_index = None if first is None else first + self.account().sent
        following = JitterBuffer(len(self._forces_n), begin_index)
        following.keep_accounts(self._lags_ns)
        return following


def _check_gap(gap_ns: int, expected_ns: int) -> None:
    if gap_ns <= 0 or abs(gap_ns - expected_ns) > TIME_TOLERANCE_NS + expected_ns // 5:
        raise WireError("timestamp", "a frame's time does not fit its sequence number")
