from itertools import accumulate

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from display_node.reception.jitter_buffer import JitterBuffer, SampleAccount
from protocol.errors import WireError
from tests.support.frames import MS, at_ns, filled, frame, refusal


class Ledger:
    """The account by brute force: the fate of each sample on its own."""

    def __init__(self) -> None:
        self.fates: dict[int, str] = {}
        self.passed_ns = 0

    def put(self, first: int, count: int) -> bool:
        new = first not in self.fates
        for sample in range(first, first + count) if new else ():
            self.fates[sample] = "late" if at_ns(sample) <= self.passed_ns else "waiting"
        return new

    def advance(self, instant_ns: int) -> None:
        self.passed_ns = max(self.passed_ns, instant_ns)
        for sample, fate in self.fates.items():
            if fate == "waiting" and at_ns(sample) <= instant_ns:
                self.fates[sample] = "played"

    def counts(self, sent: int | None) -> tuple[int, int, int, int]:
        past = [sample for sample, fate in self.fates.items() if fate != "waiting"]
        if sent is not None and len(past) == len(self.fates):
            past.append(sent - 1)
        first = min(self.fates, default=sent or 0)
        everyone = range(first, max(past, default=-1) + 1) if self.fates else ()
        fates = [self.fates.get(sample, "lost") for sample in everyone]
        return len(fates), fates.count("played"), fates.count("late"), fates.count("lost")


def counts(account: SampleAccount) -> tuple[int, int, int, int]:
    assert account.sent == account.played + account.late + account.lost
    return account.sent, account.played, account.late, account.lost


@st.composite
def histories(draw: st.DrawFn) -> tuple[list[int], list[tuple[str, int]]]:
    """Sizes of consecutive frames; and what happens: a frame comes, or time goes on by so many
    half samples (seldom back)."""
    sizes = draw(st.lists(st.integers(1, 7), min_size=1, max_size=15))
    comes = st.tuples(st.just("put"), st.integers(0, len(sizes) - 1))
    goes_on = st.tuples(st.just("advance"), st.integers(0, 24) | st.just(-40))
    return sizes, draw(st.lists(comes | goes_on, max_size=50))


@settings(max_examples=200, deadline=None)
@given(histories(), st.integers(0, 10))
def test_every_sample_is_played_late_or_lost(
    history: tuple[list[int], list[tuple[str, int]]], lost_tail: int
) -> None:
    sizes, events = history
    firsts = [0, *accumulate(sizes)]
    sent = firsts[-1] + lost_tail
    buffer, ledger = JitterBuffer(0), Ledger()
    instant_ns = at_ns(-5)
    for event, value in events:
        if event == "advance":
            instant_ns += value * MS // 2
            buffer.advance(instant_ns)
            ledger.advance(instant_ns)
        elif ledger.put(firsts[value], sizes[value]):
            buffer.put(frame(firsts[value], sizes[value]))
        else:
            assert refusal(buffer, frame(firsts[value], sizes[value])) == "duplicate"
        assert counts(buffer.account()) == ledger.counts(sent=None)
    buffer.end(sent, now_ns=at_ns(sent))
    assert counts(buffer.account()) == ledger.counts(sent)
    buffer.advance(at_ns(1000))
    ledger.advance(at_ns(1000))
    account = buffer.account()
    assert counts(account) == ledger.counts(sent)
    assert account.sent + account.before_joining == sent


def test_accounts_of_sessions_add_up() -> None:
    total = SampleAccount(10, 6, 3, 2) + SampleAccount(7, 4, 1, 1)
    assert (total, total.lost) == (SampleAccount(17, 10, 4, 3), 3)


def test_a_frame_from_before_the_first_counts_as_late() -> None:
    buffer = filled(frame(50))
    buffer.advance(at_ns(54))
    assert buffer.account() == SampleAccount(5, 5, 0, 50)
    buffer.put(frame(40))
    assert buffer.account() == SampleAccount(15, 5, 5, 40)
    assert buffer.account().lost == 5


@pytest.mark.parametrize(("instant", "late"), [(4.9, 0), (5, 1), (7, 3), (8.9, 4), (9, 5)])
def test_a_frame_that_is_partly_late_is_partly_played(instant: float, late: int) -> None:
    buffer = filled(frame(0))
    buffer.advance(at_ns(instant))
    buffer.put(frame(5))
    buffer.advance(at_ns(9.5))
    assert counts(buffer.account()) == (10, 10 - late, late, 0)


def test_what_is_forgotten_stays_in_the_account() -> None:
    buffer = JitterBuffer(0)
    dropped, sent = {3, 150}, 200 * 500
    for number in set(range(200)) - dropped:
        buffer.put(frame(500 * number, 500))
        buffer.advance(at_ns(500 * number + 499))
    assert counts(buffer.account()) == (sent, sent - 1000, 0, 1000)
    assert refusal(buffer, frame(1500, 500)) == "too_old"
    assert refusal(buffer, frame(0, 500)) == "too_old"
    # Wherever the forgetting stopped, nothing that was counted is taken again.
    again = [sample for sample in range(65_000, 85_000) if sample // 500 not in dropped]
    causes = [refusal(buffer, frame(sample, 1)) for sample in again]
    assert causes == sorted(causes, reverse=True)
    assert set(causes) == {"too_old", "duplicate"}
    assert counts(buffer.account()) == (sent, sent - 1000, 0, 1000)


def test_a_late_frame_within_its_reach_is_taken_after_forgetting() -> None:
    buffer = JitterBuffer(0)
    for number in set(range(100)) - {90}:
        buffer.put(frame(500 * number, 500))
        buffer.advance(at_ns(500 * number + 499))
    buffer.put(frame(45_000, 500))
    assert counts(buffer.account()) == (50_000, 49_500, 500, 0)


def test_after_a_jump_back_the_past_is_known_and_not_counted_again() -> None:
    frames = [frame(first) for first in range(0, 1000, 5)]
    frames = [each._replace(values=each.values**2) for each in frames]
    missing = frames.pop(100)
    buffer = filled(*frames)
    buffer.advance(at_ns(900))
    buffer.advance(at_ns(100.5))
    between = [(low**2 + (low + 0.5) ** 2) / 2 for low in (50.0, 50.5, 51.0)]
    assert buffer.known(MS, 3) == between
    buffer.put(missing)
    assert buffer.known(MS, 3) == between
    buffer.advance(at_ns(999))
    assert counts(buffer.account()) == (1000, 995, 5, 0)
    buffer.advance(at_ns(-1))
    assert buffer.known(MS, 3) == []


@pytest.mark.parametrize(
    ("samples_sent", "now_ns"),
    [(9, at_ns(20)), (10**15, at_ns(20)), (1100, at_ns(20)), (1100, None)],
)
def test_an_end_that_cannot_be_true_is_refused(samples_sent: int, now_ns: int | None) -> None:
    buffer = filled(frame(5))
    with pytest.raises(WireError) as caught:
        buffer.end(samples_sent, now_ns)
    assert caught.value.cause == "implausible"
    assert not buffer.ended
    assert buffer.end_ns is None


def test_the_end_is_the_time_of_the_last_sample_sent() -> None:
    buffer = filled(frame(5))
    buffer.end(1100, now_ns=at_ns(1100))
    assert buffer.ended
    assert buffer.end_ns == at_ns(1099)


def test_a_tail_that_never_came_is_lost_once_all_the_rest_was_played() -> None:
    buffer = filled(frame(0), frame(5))
    buffer.advance(at_ns(6))
    buffer.end(20, now_ns=at_ns(20))
    assert counts(buffer.account()) == (7, 7, 0, 0)
    buffer.advance(at_ns(9))
    assert counts(buffer.account()) == (20, 10, 0, 10)
    buffer.advance(at_ns(30))
    buffer.put(frame(15))
    assert counts(buffer.account()) == (20, 10, 5, 5)


def test_a_session_of_which_nothing_came_was_all_before_joining() -> None:
    buffer = JitterBuffer(0)
    assert buffer.account() == SampleAccount()
    buffer.end(1000, now_ns=None)
    assert buffer.account() == SampleAccount(before_joining=1000)
    assert buffer.end_ns is None
