import tracemalloc
from itertools import accumulate
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from display_node.reception.jitter_buffer import (
    KEEP_SAMPLES,
    MAX_AHEAD_SAMPLES,
    TIME_TOLERANCE_NS,
    JitterBuffer,
    SampleAccount,
)
from protocol.errors import WireError
from protocol.wire.messages import ChannelSamples, channel_samples
from tests.support.streams import MS, T0_NS, at_ns, filled, put, refusal, samples


def known(buffer: JitterBuffer, step_ns: int, count: int, begin_ns: int) -> list[float]:
    """Return values of the only channel."""
    return buffer.known(step_ns, count, begin_ns, [0])[0]


class Ledger:
    """Account by brute force: the fate of each sample."""

    def __init__(self) -> None:
        self.fates: dict[int, str] = {}
        self.passed_ns = 0
        # Each advance: the instant that it passed last, and whether a prediction was trusted.
        self.passes: list[tuple[int, bool]] = []

    def put(self, first: int, count: int) -> bool:
        new = first not in self.fates
        for sample in range(first, first + count) if new else ():
            self.fates[sample] = "waiting"
            if at_ns(sample) <= self.passed_ns:
                felt = (by for passed_ns, by in self.passes if at_ns(sample) <= passed_ns)
                self.fates[sample] = "predicted" if next(felt) else "late"
        return new

    def advance(self, sampled_ns: int, trusted: bool) -> None:
        self.passed_ns = max(self.passed_ns, sampled_ns)
        self.passes.append((self.passed_ns, trusted))
        for sample, fate in self.fates.items():
            if fate == "waiting" and at_ns(sample) <= sampled_ns:
                self.fates[sample] = "played"

    def counts(self, sent: int | None) -> tuple[int, ...]:
        past = [sample for sample, fate in self.fates.items() if fate != "waiting"]
        if sent is not None and len(past) == len(self.fates):
            past.append(sent - 1)
        first = min(self.fates, default=sent or 0)
        everyone = range(first, max(past, default=-1) + 1) if self.fates else ()
        fates = [self.fates.get(sample, "lost") for sample in everyone]
        outcomes = ("played", "predicted", "late", "lost")
        return len(fates), *(fates.count(outcome) for outcome in outcomes)


def counts(account: SampleAccount) -> tuple[int, ...]:
    outcomes = account.played, account.predicted, account.late, account.lost
    assert account.sent == sum(outcomes)
    return account.sent, *outcomes


@st.composite
def histories(draw: st.DrawFn) -> tuple[list[int], list[tuple[str, int]]]:
    """Draw sizes of consecutive frames, and events.

    An event puts a frame, or advances by half samples, with a prediction that is trusted or not.
    """
    sizes = draw(st.lists(st.integers(1, 7), min_size=1, max_size=15))
    put = st.tuples(st.just("put"), st.integers(0, len(sizes) - 1))
    advance = st.tuples(st.sampled_from(["advance", "trusted"]), st.integers(0, 24) | st.just(-40))
    return sizes, draw(st.lists(put | advance, max_size=50))


@settings(max_examples=200)
@given(histories(), st.integers(0, 10))
def test_every_sample_is_played_predicted_late_or_lost(
    history: tuple[list[int], list[tuple[str, int]]], lost_tail: int
) -> None:
    sizes, events = history
    firsts = [0, *accumulate(sizes)]
    sent = firsts[-1] + lost_tail
    buffer, ledger = JitterBuffer(), Ledger()
    sampled_ns = at_ns(-5)
    for event, value in events:
        if event != "put":
            sampled_ns += value * MS // 2
            buffer.advance(sampled_ns, event == "trusted")
            ledger.advance(sampled_ns, event == "trusted")
        elif ledger.put(firsts[value], sizes[value]):
            put(buffer, samples(firsts[value], sizes[value]))
        else:
            assert refusal(buffer, samples(firsts[value], sizes[value])) == "duplicate"
        assert counts(buffer.account()) == ledger.counts(sent=None)
    buffer.end(sent, now_ns=at_ns(sent))
    assert counts(buffer.account()) == ledger.counts(sent)
    buffer.advance(at_ns(1000))
    ledger.advance(at_ns(1000), trusted=False)
    account = buffer.account()
    assert counts(account) == ledger.counts(sent)
    assert account.sent + account.before_joining == sent


def test_how_an_instant_was_felt_is_known_as_long_as_its_sample_may_come() -> None:
    buffer = JitterBuffer()
    tracemalloc.start()
    try:
        for number in range(400):
            if number != 398:
                put(buffer, samples(500 * number, 500))
            for sample in range(500 * number, 500 * number + 500):
                buffer.advance(at_ns(sample), trusted=sample % 2 == 1)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 200 * 2 * KEEP_SAMPLES
    put(buffer, samples(199_000, 500))
    assert counts(buffer.account()) == (200_000, 199_500, 250, 250, 0)


def test_removed_samples_stay_in_the_account() -> None:
    buffer = JitterBuffer()
    dropped, sent = {3, 150, 190}, 200 * 500
    for number in set(range(200)) - dropped:
        put(buffer, samples(500 * number, 500))
        buffer.advance(at_ns(500 * number + 499))
    assert counts(buffer.account()) == (sent, sent - 1500, 0, 0, 1500)
    assert [refusal(buffer, samples(first, 500)) for first in (1500, 0)] == ["too_old"] * 2
    # No sample that was counted is taken again, removed or not.
    again = [sample for sample in range(65_000, 85_000) if sample // 500 not in dropped]
    causes = [refusal(buffer, samples(sample, 1)) for sample in again]
    assert causes == sorted(causes, reverse=True)
    assert set(causes) == {"too_old", "duplicate"}
    assert counts(buffer.account()) == (sent, sent - 1500, 0, 0, 1500)
    # A missing frame within reach is taken.
    put(buffer, samples(95_000, 500))
    assert counts(buffer.account()) == (sent, sent - 1500, 0, 500, 1000)


def test_samples_played_again_after_a_jump_back_are_counted_once() -> None:
    frames = [samples(first) for first in range(0, 1000, 5)]
    frames = [each._replace(forces_n=[value**2 for value in each.forces_n]) for each in frames]
    missing = frames.pop(100)
    buffer = filled(*frames)
    buffer.advance(at_ns(900))
    buffer.advance(at_ns(100.5))
    between = [(low**2 + (low + 0.5) ** 2) / 2 for low in (50.0, 50.5, 51.0)]
    assert known(buffer, MS, 3, at_ns(100.5)) == between
    put(buffer, missing)
    assert known(buffer, MS, 3, at_ns(100.5)) == between
    buffer.advance(at_ns(999))
    assert counts(buffer.account()) == (1000, 995, 0, 5, 0)
    buffer.advance(at_ns(-1))
    assert known(buffer, MS, 3, at_ns(-1)) == []


@pytest.mark.parametrize(
    ("samples_sent", "now_ns"),
    [(9, at_ns(20)), (10**15, at_ns(20)), (1100, at_ns(20)), (1100, None)],
)
def test_an_implausible_end_is_refused(samples_sent: int, now_ns: int | None) -> None:
    buffer = filled(samples(5))
    with pytest.raises(WireError) as caught:
        buffer.end(samples_sent, now_ns)
    assert caught.value.cause == "implausible"
    assert (buffer.ended, buffer.end_ns) == (False, None)
    # The end is the time of the last sample sent.
    buffer.end(1100, now_ns=at_ns(1100))
    assert (buffer.ended, buffer.end_ns) == (True, at_ns(1099))


def test_duplicates_and_overlaps_are_refused_and_change_nothing() -> None:
    buffer = filled(samples(0), samples(10), samples(20))
    buffer.advance(at_ns(2))
    values = known(buffer, MS, 20, at_ns(2))
    before = (buffer.account(), buffer.waiting, buffer.frames, values)
    for first, count in ((3, 4), (5, 6), (9, 2), (10, 30), (22, 5)):
        assert refusal(buffer, samples(first, count)) == "overlap", first
    altered = samples(10)._replace(forces_n=[99.0] * 5)
    for again in (samples(0), altered, samples(11, 3), samples(24, 1)):
        assert refusal(buffer, again) == "duplicate"
    values = known(buffer, MS, 20, at_ns(2))
    assert (buffer.account(), buffer.waiting, buffer.frames, values) == before


def test_a_time_that_does_not_fit_the_neighbours_is_refused() -> None:
    buffer = filled(samples(100, 1), samples(104, 1))
    beyond_ms = TIME_TOLERANCE_NS // MS + 20
    for first, shifts_ms in ((200, (-100, beyond_ms)), (50, (50, -beyond_ms, 60)), (102, (2, -2))):
        for shift_ms in shifts_ms:
            assert refusal(buffer, samples(first, 1, shift_ms * MS)) == "timestamp", shift_ms
    assert buffer.frames == 2
    # A clock that drifts within the tolerance is accepted.
    for shift_ns in (-TIME_TOLERANCE_NS // 2, TIME_TOLERANCE_NS):
        assert filled(samples(0), samples(1000, shift_ns=shift_ns)).frames == 2


@pytest.mark.parametrize("order", [1, -1])
def test_waiting_samples_and_their_memory_are_limited(order: int) -> None:
    buffer, size = JitterBuffer(), 512
    most = MAX_AHEAD_SAMPLES // size
    firsts = range(0, 5 * MAX_AHEAD_SAMPLES // 2, size)[::order]
    tracemalloc.start()
    try:
        for first in firsts[:most]:
            put(buffer, samples(first, size))
        assert {refusal(buffer, samples(first, size)) for first in firsts[most:]} == {"overflow"}
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert buffer.waiting == MAX_AHEAD_SAMPLES
    assert peak < 30_000_000


def test_played_samples_do_not_count_as_waiting() -> None:
    buffer = filled(*(samples(first, 4000) for first in range(0, 32_000, 4000)))
    buffer.advance(at_ns(31_999))
    for first in range(32_000, 32_000 + MAX_AHEAD_SAMPLES - 4000, 4000):
        put(buffer, samples(first, 4000))
    assert buffer.waiting == 64_000


def test_values_are_returned_while_many_samples_wait() -> None:
    buffer = filled(*(samples(first, 1000) for first in range(0, 2 * KEEP_SAMPLES - 1000, 1000)))
    for first in range(32_000, 36_000, 1000):
        buffer.advance(at_ns(10_000.5))
        put(buffer, samples(first, 1000))
        assert known(buffer, MS, 2, at_ns(10_000.5)) == [5000.25, 5000.75]


@given(
    st.lists(st.booleans(), min_size=1, max_size=8),
    st.floats(0, 40),
    st.integers(1, 3 * MS),
    st.integers(1, 30),
)
def test_a_straight_line_is_exact_even_across_missing_frames(
    missing: list[bool], start: float, step_ns: int, count: int
) -> None:
    here = [number for number, gone in enumerate([False, *missing, False]) if not gone]
    buffer = filled(*(samples(5 * number) for number in here))
    newest_ns, sampled_ns = at_ns(5 * here[-1] + 4), at_ns(start)
    buffer.advance(sampled_ns)
    instants = [sampled_ns + i * step_ns for i in range(count)]
    expected = [0.5 * (t_ns - T0_NS) / MS for t_ns in instants if t_ns <= newest_ns]
    assert known(buffer, step_ns, count, sampled_ns) == pytest.approx(expected, abs=1e-12)
    assert buffer.newest_ns == newest_ns


def test_no_value_is_returned_before_the_first_sample() -> None:
    buffer = JitterBuffer()
    assert (known(buffer, MS, 2, at_ns(10)), buffer.newest_ns) == ([], None)
    put(buffer, samples(10))
    buffer.advance(at_ns(9.9))
    assert known(buffer, MS, 2, at_ns(9.9)) == []
    buffer.advance(at_ns(10))
    assert known(buffer, MS, 2, at_ns(10)) == [5.0, 5.5]


@pytest.mark.parametrize("order", [1, -1], ids=["in order", "out of order"])
@pytest.mark.parametrize("channel", [0, 1, 2])
def test_each_channel_is_kept(channel: int, order: int) -> None:
    forces_n = [[1.0, 2.0, 3.0, 4.0], [10.0, 20.0, 30.0, 40.0], [100.0, 200.0, 300.0, 400.0]]
    original = JitterBuffer(3)
    for buffer in (original, original.successor()):
        for first in (0, 2)[::order]:
            times_ns = [at_ns(first), at_ns(first + 1)]
            buffer.put(first, MS, times_ns, [each[first : first + 2] for each in forces_n])
        buffer.advance(at_ns(0))
        assert buffer.known(MS, 4, at_ns(0), [channel]) == [forces_n[channel]]


@pytest.mark.parametrize("instant_ms", [-1.0, 0.0, 1.25, 3.0])
@pytest.mark.parametrize("step_ns", [MS // 2, MS])
def test_channels_read_together_are_those_read_alone(instant_ms: float, step_ns: int) -> None:
    forces_n = [[1.0, 4.0, 9.0, 16.0], [0.1, 0.7, 0.3, 0.9], [1.0, 4.0, 9.0, 16.0]]
    buffer = JitterBuffer(3)
    buffer.put(0, MS, [0, MS, 2 * MS, 3 * MS], forces_n)
    buffer.advance(4 * MS)
    begin_ns = round(instant_ms * MS)
    together = buffer.known(step_ns, 4, begin_ns, [1, 2, 0])
    assert together == [buffer.known(step_ns, 4, begin_ns, [each])[0] for each in (1, 2, 0)]
    assert together[1] == together[2] != together[0] or not together[0]


@pytest.mark.parametrize("seed", range(8))
def test_each_contactors_account_is_that_of_a_buffer_of_its_own(seed: int) -> None:
    """The account of a contactor that plays later is that of a buffer that plays later."""
    random, lags_ns = Random(seed), (0, 3 * MS, 8 * MS)
    shared, own = JitterBuffer(), [JitterBuffer() for _ in lags_ns]
    shared.keep_accounts(lags_ns)
    arrivals: dict[int, list[ChannelSamples]] = {}
    for first in range(0, 1_000, 5):
        if random.random() < 0.05:
            continue
        frame = channel_samples(first, first * MS, MS, [0.0] * 5)
        arrivals.setdefault(first + 5 + random.randrange(40), []).append(frame)
    trusted = False
    for ms in range(1_100):
        for frame in arrivals.get(ms, []):
            for buffer in (shared, *own):
                put(buffer, frame)
        trusted ^= random.random() < 0.02
        # The playout pauses, and is faster, at times.
        sampled_ns = ms * MS - 25 * MS + random.randrange(3) * MS
        shared.advance(sampled_ns, trusted)
        for buffer, lag_ns in zip(own, lags_ns, strict=True):
            buffer.advance(sampled_ns - lag_ns, trusted)
    for buffer in (shared, *own):
        buffer.end(1_000, None)
    assert shared.accounts() == [buffer.account() for buffer in own]
    assert len({account.late for account in shared.accounts()}) == 3
    assert JitterBuffer().accounts() == []
