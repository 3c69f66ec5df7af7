"""Two connections of a data path in virtual time, over a model of TCP on a link that is cut."""

import random
from dataclasses import dataclass, field

import pytest

from display_node.reception.failover import Failover, Keep
from display_node.reception.timeouts import Timeouts

MS = 1_000_000
FRAME_MS, ONE_WAY_MS = 5, 20
ANSWER_MS = 120
RTO_MS, MAX_RTO_MS = 200 + 2 * ONE_WAY_MS, 120_000
# Connect, greet, agree, subscribe; then the first frame comes.
ROUND_TRIPS = 4
ASK_AGAIN_MS = 35
FRESH_MS = 60


@dataclass
class Link:
    """Link that is cut between instants; else each packet is lost with a probability."""

    cuts_ms: list[tuple[int, int]] = field(default_factory=list)
    loss: float = 0.0
    rng: random.Random = field(default_factory=lambda: random.Random(0))

    def passes(self, ms: int) -> bool:
        cut = any(begin <= ms < end for begin, end in self.cuts_ms)
        return not cut and self.rng.random() >= self.loss


@dataclass
class Tcp:
    """TCP connection: a lost frame delays all later ones; it is repeated after 1, 2, 4… RTO_MS.

    next: first frame that it has not delivered. window: packets a round trip, while the queue
    drains.
    """

    link: Link
    next: int
    stuck: bool = False
    again_ms: int = 0
    rto_ms: int = RTO_MS
    window: int = 0

    def delivers(self, ms: int) -> list[int]:
        """Return the frames that arrive now."""
        newest = ms // FRAME_MS
        if self.stuck:
            if ms < self.again_ms:
                return []
            if not self.link.passes(ms):
                self.rto_ms = min(2 * self.rto_ms, MAX_RTO_MS)
                self.again_ms = ms + self.rto_ms
                return []
            self.stuck, self.rto_ms, self.window = False, RTO_MS, 1
        elif self.window:
            if ms < self.again_ms:
                return []
            self.window *= 2
        elif ms % FRAME_MS:
            return []
        # Three of four losses are repeated at once, as later packets show them.
        elif not self.link.passes(ms) and not (self.link.loss and self.link.rng.random() < 0.75):
            self.stuck, self.again_ms = True, ms + self.rto_ms
            return []
        self.again_ms = ms + 2 * ONE_WAY_MS
        end = newest + 1
        if self.window:
            end = min(end, self.next + self.window)
            self.window = 0 if end > newest else self.window
        frames = list(range(self.next, end))
        self.next = end
        return frames


@dataclass
class Opening:
    """Connection that is being opened: requests are repeated early, later packets as by TCP."""

    link: Link
    next_ms: int
    trips: int = 0
    rto_ms: int = RTO_MS

    def step(self, ms: int) -> bool:
        """Advance to a time, and return whether the connection is open and delivers."""
        if ms < self.next_ms:
            return False
        if self.link.passes(ms):
            self.trips, self.rto_ms = self.trips + 1, RTO_MS
            self.next_ms = ms + 2 * ONE_WAY_MS
        elif self.trips == 0:
            self.next_ms = ms + ANSWER_MS + ASK_AGAIN_MS
        else:
            self.next_ms, self.rto_ms = ms + self.rto_ms, 2 * self.rto_ms
        return self.trips > ROUND_TRIPS


@dataclass
class Played:
    """Course of a run: the time at which each frame arrived first."""

    failover: Failover
    came_ms: dict[int, int] = field(default_factory=dict)

    def back_ms(self, end_ms: int) -> int:
        """Return the time from the end of a cut to the arrival of a frame that is still fresh."""
        fresh = [ms for frame, ms in self.came_ms.items() if ms - frame * FRAME_MS <= FRESH_MS]
        return min(ms for ms in fresh if ms >= end_ms) - end_ms

    def missing(self, before_ms: int) -> int:
        return sum(frame not in self.came_ms for frame in range(before_ms // FRAME_MS))


def started(frame_ms: int = FRAME_MS) -> Failover:
    """Return a failover that begins at 0 ms, with a frame every `frame_ms`."""
    failover = Failover()
    failover.set_timeouts(Timeouts(frame_ms * MS, ANSWER_MS * MS))
    failover.start(0)
    return failover


def racing() -> Failover:
    """Return a failover whose second connection has been opened at 320 ms."""
    failover = started()
    assert failover.due(320 * MS)
    return failover


def play(link: Link, until_ms: int) -> Played:
    """Run frames over two connections, as `DataPath` reads them."""
    failover = started()
    played = Played(failover)
    first, second, opening = Tcp(link, 0), None, None
    had: list[set[int]] = [set(), set()]
    for ms in range(until_ms):
        now_ns = ms * MS
        if opening is not None:
            if opening.trips:
                failover.answered(now_ns)
            if second is None and opening.step(ms):
                second = Tcp(link, ms // FRAME_MS)
        frames = [first.delivers(ms), second.delivers(ms) if second is not None else []]
        for frame in (*frames[0], *frames[1]):
            played.came_ms.setdefault(frame, ms)
        again = [bool(had[1].intersection(frames[0])), bool(had[0].intersection(frames[1]))]
        keep = failover.first_received(now_ns, again[0], len(frames[0])) if frames[0] else None
        if frames[1]:
            keep = keep or failover.second_received(now_ns, again[1])
        keep = keep or failover.settle(now_ns)
        if failover.racing:
            had = [kept.union(new) for kept, new in zip(had, frames, strict=True)]
        if keep is Keep.SECOND:
            assert second is not None
            first = second
        if keep is not None:
            second, opening, had = None, None, [set(), set()]
        if failover.due(now_ns):
            second, opening, had[1] = None, Opening(link, ms), set()
    return played


@pytest.mark.parametrize(
    ("least_ms", "most_ms", "seeds"), [(100, 600, 60), (600, 3_000, 30), (3_000, 30_000, 8)]
)
def test_fresh_frames_arrive_within_half_a_second_of_any_cut(
    least_ms: int, most_ms: int, seeds: int
) -> None:
    worst_ms, opened = 0, 0
    for seed in range(seeds):
        rng = random.Random(seed)
        begin_ms = rng.randrange(1_000, 1_500)
        end_ms = begin_ms + rng.randrange(least_ms, most_ms)
        played = play(Link([(begin_ms, end_ms)]), end_ms + 3_000)
        worst_ms = max(worst_ms, played.back_ms(end_ms))
        opened += played.failover.opened
        assert not played.failover.racing
        # Where TCP recovers soon, nothing is lost by the race.
        if end_ms - begin_ms < 2 * RTO_MS:
            assert played.missing(end_ms + 2_000) == 0
    # The next request to connect, and the handshakes.
    assert worst_ms <= 500
    assert opened > 0


def test_a_second_cut_during_the_handshake_is_survived() -> None:
    for seed in range(30):
        rng = random.Random(seed)
        end_ms = 1_000 + rng.randrange(600, 1_500)
        again_ms = end_ms + rng.randrange(0, 300)
        over_ms = again_ms + rng.randrange(100, 600)
        link = Link([(1_000, end_ms), (again_ms, over_ms)])
        assert play(link, over_ms + 3_000).back_ms(over_ms) <= 700


@pytest.mark.parametrize("loss", [0.0, 0.05, 0.2])
def test_new_connections_over_a_lossy_link_are_bounded(loss: float) -> None:
    minutes = 2
    played = play(Link(loss=loss, rng=random.Random(1)), minutes * 60_000)
    assert len(played.came_ms) > 1_000
    assert played.failover.opened <= (30 * minutes + 10 if loss else 0)


def test_a_peer_that_stalls_is_reconnected_less_and_less_often() -> None:
    failover = started()
    for ms in range(60_000):
        if failover.due(ms * MS):
            # The peer's kernel answers.
            failover.answered(ms * MS)
    assert 30 <= failover.opened <= 40
    # The peer resumes: the first delivers its queue, until it repeats a frame of the second.
    assert failover.first_received(60_000 * MS, behind=False, count=1) is None
    assert failover.second_received(60_001 * MS, behind=False) is None
    assert failover.first_received(60_002 * MS, behind=True, count=1) is Keep.SECOND
    assert not failover.due(60_003 * MS)


def test_the_first_is_kept_if_it_is_up_to_date_before_the_second() -> None:
    failover = racing()
    failover.answered(540 * MS)
    assert failover.first_received(600 * MS, behind=False, count=1) is None
    assert failover.second_received(650 * MS, behind=True) is Keep.FIRST
    assert (failover.racing, failover.opened, failover.kept) == (False, 1, 0)


def test_the_only_connection_that_delivers_is_kept_after_a_second() -> None:
    failover = racing()
    for ms in range(700, 1_700, FRAME_MS):
        assert failover.second_received(ms * MS, behind=False) is None
        assert failover.settle(ms * MS) is None
    assert failover.settle(1_700 * MS) is Keep.SECOND
    failover = racing()
    for ms in range(2_000, 3_000, FRAME_MS):
        assert failover.first_received(ms * MS, behind=False, count=1) is None
        assert failover.settle(ms * MS) is None
    assert failover.settle(3_000 * MS) is Keep.FIRST
    assert_due_at(failover, 3_320)


def assert_due_at(failover: Failover, ms: int) -> None:
    assert not failover.due((ms - 1) * MS)
    assert failover.due(ms * MS)


@pytest.mark.parametrize("frame_ms", [0, 5, 100, 10_000])
@pytest.mark.parametrize("answer_ms", [100, 150, 2_000])
def test_a_second_connection_is_opened_before_all_are_made_anew(
    frame_ms: int, answer_ms: int
) -> None:
    timeouts = Timeouts(frame_ms * MS, answer_ms * MS)
    assert timeouts.follows_ns <= timeouts.silence_ns <= timeouts.cut_ns
    assert min(timeouts.silence_ns, timeouts.stalled_ns, timeouts.unanswered_ns) >= answer_ms * MS


def test_patience_is_longer_for_rare_frames_and_shorter_after_a_stall() -> None:
    assert_due_at(started(frame_ms=10_000), 30_000)
    failover = Failover()
    failover.start(0)
    failover.first_received(1_000 * MS, behind=False, count=1)
    failover.mark_suspect(1_000 * MS)
    failover.first_received(1_010 * MS, behind=False, count=1)
    assert_due_at(failover, 1_160)


def test_silence_after_the_end_of_a_stream_is_no_cut() -> None:
    failover = started()
    # No frames are owed from the time before the first one.
    failover.first_received(1_000 * MS, behind=False, count=1)
    assert not failover.due(1_319 * MS)
    failover.set_timeouts(Timeouts(1_000 * MS, ANSWER_MS * MS))
    assert_due_at(failover, 4_000)


@pytest.mark.parametrize(
    ("arrivals", "due_ms"), [([(300, 1), (340, 2), (380, 4)], 400), ([(300, 60)], 620)]
)
def test_a_first_connection_that_resumes_must_catch_up_soon(
    arrivals: list[tuple[int, int]], due_ms: int
) -> None:
    failover = started()
    for ms, count in [(0, 1), *arrivals]:
        failover.first_received(ms * MS, behind=False, count=count)
    assert_due_at(failover, due_ms)
