"""Opening and closing of further connections, in virtual time over the model of TCP."""

import heapq
from collections.abc import Iterable, Iterator

import pytest

from display_node.reception.redundancy import MAX_PATHS, Redundancy, StallMeter
from telepulse.simulation.link_model import MessageLink
from telepulse.simulation.link_scene import parse_link

MS = 1_000_000
TICK_MS, FRAME_MS, ROUND_TRIP_MS = 1, 10, 27
OUTAGE_MS = 300
HOUR_S = 3_600
# A new connection delivers after its handshakes.
HANDSHAKES_MS = 4 * ROUND_TRIP_MS
LINK = "delay=20ms,jitter=3ms,transport=tcp"


def arrivals_ns(link: str, frame_ms: int, until_s: int, seed: int = 1) -> Iterator[int]:
    """Yield when each frame arrives over a connection of its own, and 1 << 62 for a lost one."""
    model = MessageLink(parse_link(link), seed)
    for sent_ms in range(frame_ms, until_s * 1000, frame_ms):
        yield model.data_arrival_ns(sent_ms * MS, 200) or 1 << 62


def built(frame_ms: int = FRAME_MS, round_trip_ms: int = ROUND_TRIP_MS) -> Redundancy:
    redundancy = Redundancy(late_target=0.01)
    redundancy.set_times(frame_ms * MS, round_trip_ms * MS, OUTAGE_MS * MS)
    return redundancy


def tick_after(at_ns: int) -> int:
    """Return the first tick at which an arrival can be read."""
    return -(-at_ns // (TICK_MS * MS)) * TICK_MS * MS


class Rig:
    """Frames over as many connections as are decided, of which each is polled every tick.

    changes: time in s, number of connections from then on, and the reason. first_ms: delay of each
    frame's first copy, by its number.
    """

    def __init__(self, links: list[Iterator[int]], frame_ms: int = FRAME_MS) -> None:
        self.redundancy = built(frame_ms)
        self.changes: list[tuple[float, int, str]] = []
        self.first_ms: dict[int, float] = {}
        self._links, self._frame_ms = links, frame_ms

    def play(self) -> "Rig":
        """Run until the first link ends."""
        redundancy, opened_ms = self.redundancy, [0] * len(self._links)
        events: list[tuple[int, int, int]] = []
        for number, arrivals in enumerate(zip(*self._links, strict=True), 1):
            sent_ms = number * self._frame_ms
            self._read(events, sent_ms * MS)
            for path, at_ns in enumerate(arrivals):
                if path < redundancy.paths and opened_ms[path] <= sent_ms and at_ns < 1 << 62:
                    heapq.heappush(events, (tick_after(at_ns), path, number))
                    sooner = min(self.first_ms.get(number, 1e9), at_ns / MS - sent_ms)
                    self.first_ms[number] = sooner
                elif path >= redundancy.paths:
                    opened_ms[path] = sent_ms + HANDSHAKES_MS
        return self

    def _read(self, events: list[tuple[int, int, int]], until_ns: int) -> None:
        while events and events[0][0] <= until_ns:
            now_ns, counts = events[0][0], [0] * len(self._links)
            while events and events[0][0] == now_ns:
                counts[heapq.heappop(events)[1]] += 1
            self.redundancy.received(counts[0], sum(counts), now_ns, now_ns - TICK_MS * MS)
            reason = self.redundancy.change(now_ns)
            if reason:
                self.changes.append((now_ns / 1e9, self.redundancy.paths, reason))

    def p99_ms(self, from_s: float) -> float:
        """Return the 99th percentile of the delay of the frames sent from a time on."""
        delays_ms = sorted(
            ms for number, ms in self.first_ms.items() if number * self._frame_ms >= from_s * 1e3
        )
        return delays_ms[round(0.99 * (len(delays_ms) - 1))]


def rig(link: str, seconds: int, frame_ms: int = FRAME_MS) -> Rig:
    """Play over connections of which each meets other losses."""
    seeds = range(1, MAX_PATHS + 1)
    return Rig([arrivals_ns(link, frame_ms, seconds, seed) for seed in seeds], frame_ms).play()


@pytest.mark.system
@pytest.mark.parametrize(
    ("link", "frame_ms"),
    [
        ("delay=40ms,jitter=10ms,transport=tcp", 5),
        ("delay=40ms,jitter=10ms,loss=1%", 10),
    ],
)
def test_no_connection_is_opened_in_an_hour_of_jitter(link: str, frame_ms: int) -> None:
    assert Rig([arrivals_ns(link, frame_ms, HOUR_S)], frame_ms).play().changes == []


@pytest.mark.parametrize("loss", ["1%", "3%"])
def test_connections_are_opened_at_a_loss_until_the_first_copies_hide_it(loss: str) -> None:
    lossy = rig(LINK + f",loss={loss}", 60)
    assert [paths for _, paths, _ in lossy.changes] == [2, 3]
    assert lossy.changes[0][2].startswith("TCP stalled for 1.")
    opened_s = lossy.changes[1][0] + 1
    assert opened_s < 10
    free = Rig([arrivals_ns(LINK, FRAME_MS, 60)]).play()
    assert lossy.p99_ms(opened_s) < 1.1 * free.p99_ms(opened_s)


def test_one_connection_alone_does_not_hide_a_loss() -> None:
    free = Rig([arrivals_ns(LINK, FRAME_MS, 60)]).play()
    assert Rig([arrivals_ns(LINK + ",loss=1%", FRAME_MS, 60)]).play().p99_ms(0) > 2 * free.p99_ms(0)


def test_connections_that_stall_together_are_closed_and_left_closed_for_ten_minutes() -> None:
    links = [arrivals_ns(LINK + ",loss=1%", FRAME_MS, 700) for _ in range(MAX_PATHS)]
    changes = Rig(links).play().changes
    assert [paths for _, paths, _ in changes[:4]] == [2, 3, 1, 2]
    (closed_s, _, reason), (again_s, _, _) = changes[2:4]
    assert reason == "all connections stall at the same time"
    assert closed_s < 30
    assert 600 < again_s - closed_s < 620


def test_after_five_minutes_without_loss_one_connection_is_left() -> None:
    def lossy_then_free(seed: int) -> Iterable[int]:
        lossy = arrivals_ns(LINK + ",loss=1%", FRAME_MS, 30, seed)
        free = arrivals_ns(LINK, FRAME_MS, 400, seed)
        for number, at_ns in enumerate(free):
            yield next(lossy, at_ns) if number * FRAME_MS < 29_000 else at_ns

    changes = Rig([iter(lossy_then_free(seed)) for seed in range(MAX_PATHS)]).play().changes
    assert [paths for _, paths, _ in changes] == [2, 3, 1]
    assert 320 < changes[2][0] < 345
    assert changes[2][2] == "TCP has hardly stalled for 5 min"


def stalls(gap_ms: int, bunch: int, polled_ms: int | None = None) -> int:
    """Return the stalls counted in ten gaps, of which each is followed by a bunch.

    polled_ms: time before a bunch at which this process last polled; by default a tick.
    """
    meter = StallMeter()
    meter.set_times(FRAME_MS * MS, ROUND_TRIP_MS * MS, OUTAGE_MS * MS)
    now_ms, found = 0, 0
    for _ in range(10):
        for _ in range(50):
            now_ms += FRAME_MS
            found += meter.received(1, now_ms * MS, (now_ms - TICK_MS) * MS)
        now_ms += gap_ms
        found += meter.received(bunch, now_ms * MS, (now_ms - (polled_ms or TICK_MS)) * MS)
    assert meter.recent(now_ms * MS)[0] == found
    return found


def test_a_gap_and_a_bunch_make_a_stall() -> None:
    assert stalls(gap_ms=60, bunch=6) == 10
    # The stream paused: nothing had queued.
    assert stalls(gap_ms=60, bunch=1) == 0
    # Jitter.
    assert stalls(gap_ms=35, bunch=4) == 0
    # An outage, after which the connection is replaced.
    assert stalls(gap_ms=2_000, bunch=200) == 0
    # This process stalled, and the frames queued meanwhile.
    assert stalls(gap_ms=60, bunch=6, polled_ms=55) == 0


def test_a_bunch_that_is_read_in_parts_ends_one_stall() -> None:
    meter = StallMeter()
    meter.set_times(FRAME_MS * MS, ROUND_TRIP_MS * MS, OUTAGE_MS * MS)
    for now_ms in range(0, 100, FRAME_MS):
        assert not meter.received(1, now_ms * MS, (now_ms - TICK_MS) * MS)
    assert not meter.received(1, 160 * MS, 159 * MS)
    assert not meter.received(1, 161 * MS, 160 * MS)
    assert meter.received(4, 162 * MS, 161 * MS)
    assert meter.recent(162 * MS) == (1, pytest.approx(59e-4, abs=11e-4))
    assert meter.recent(20_000 * MS) == (0, 0)
