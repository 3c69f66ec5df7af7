"""The link model: its scene, each impairment by its statistics over many packets, one a
millisecond, and messages over TCP, one each 10 ms over a link of 20 ms."""

import math
from itertools import groupby

import numpy as np
import pytest

from protocol.errors import SceneError
from telepulse.simulation.link_model import Direction, MessageLink, TcpStream
from telepulse.simulation.link_scene import parse_link
from tests.support.refusals import refusal_of

MS = 1_000_000
PACKETS = 40_000
BYTES = 100
STEP = 10
EVERYTHING = (
    "delay=40ms,jitter=10ms,jitter_kind=pareto,loss=1%,burst_loss.share=2%,burst_loss.length=50ms,"
    "reorder.share=3%,reorder.by=20ms,rate=2Mbit/s,route_change.at=5s,route_change.by=-10ms,"
    "cut.from=7s,cut.for=1.5s,stall.for=300ms,stall.every=20s,wander.by=30ms,wander.over=2s,"
    "transport=tcp"
)


def test_everything_a_link_can_do_is_read_and_written() -> None:
    assert parse_link(" delay = 1 s ") == parse_link("delay=1000ms")
    for text in ("", "delay=40ms,loss=1%", "cut.from=1s,cut.for=1s", EVERYTHING):
        assert parse_link(parse_link(text).text()) == parse_link(text)
    link = parse_link(EVERYTHING)
    assert (link.delay_ns, link.jitter_ns, link.loss) == (40_000_000, 10_000_000, 0.01)
    assert link.burst_loss is not None
    assert (link.burst_loss.share, link.burst_loss.length_ns) == (0.02, 50_000_000)
    assert link.reorder is not None
    assert (link.reorder.share, link.reorder.by_ns) == (0.03, 20_000_000)
    assert link.rate_bit_per_s == 2e6
    assert link.route_change is not None
    assert (link.route_change.at_ns, link.route_change.by_ns) == (5_000_000_000, -10_000_000)
    assert link.cut is not None
    assert (link.cut.from_ns, link.cut.for_ns) == (7_000_000_000, 1_500_000_000)
    assert link.stall is not None
    assert (link.stall.for_ns, link.stall.every_ns) == (300_000_000, 20_000_000_000)
    assert link.wander is not None
    assert (link.wander.by_ns, link.wander.over_ns) == (30_000_000, 2_000_000_000)
    assert (link.jitter_kind, link.transport) == ("pareto", "tcp")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("delay=40", ["delay", "time"]),
        ("delay=-1ms", ["delay", "greater"]),
        ("loss=2", ["loss", "less"]),
        ("dealy=1ms", ["dealy", "unknown key", "did you mean delay?"]),
        ("transport=udp", ["transport", "datagram", "tcp"]),
        ("rate=1bit/s", ["rate", "greater than or equal to 1000"]),
        ("cut=3s,cut.from=3s", ["cut", "table"]),
        ("cut.from=3s", ["cut.for", "missing"]),
        ("burst_loss.share=100%,burst_loss.length=50ms", ["burst_loss.share", "less than 1"]),
        ("transport=tcp,loss=100%", ["tcp", "loss"]),
    ],
)
def test_a_bad_link_is_one_line_that_says_what(text: str, words: list[str]) -> None:
    line = refusal_of(SceneError, parse_link, text)
    for word in (text, *words):
        assert word in line


def arrivals(text: str, packets: int = PACKETS, seed: int = 1) -> list[int | None]:
    """Return the arrival in ns of the packet of each millisecond."""
    direction = Direction(parse_link(text), seed)
    return [direction.arrival_ns(sent * MS, BYTES) for sent in range(packets)]


def delays_ms(text: str, packets: int = PACKETS) -> np.ndarray:
    """Delays of the packets that arrive."""
    return np.array(
        [arrival / MS - sent for sent, arrival in enumerate(arrivals(text, packets)) if arrival]
    )


def runs_of_loss(text: str, packets: int = PACKETS) -> list[int]:
    """Return the length of each run of lost packets."""
    fates = groupby(arrivals(text, packets), key=lambda arrival: arrival is None)
    return [len(list(run)) for lost, run in fates if lost]


def test_gaussian_jitter_goes_both_ways_and_never_below_no_delay() -> None:
    delays = delays_ms("delay=40ms,jitter=10ms")
    assert delays.mean() == pytest.approx(40, abs=0.2)
    assert delays.std() == pytest.approx(10, abs=0.2)
    assert np.mean(delays < 30) == pytest.approx(0.1587, abs=0.01)
    assert delays_ms("delay=1ms,jitter=10ms").min() == 0


def test_pareto_jitter_only_makes_later_with_a_heavy_tail() -> None:
    extra = delays_ms("delay=40ms,jitter=10ms,jitter_kind=pareto") - 40
    # A Lomax distribution of shape 3: mean scale/2, deviation scale·√3/2.
    scale = 10 * 2 / math.sqrt(3)
    assert extra.min() >= 0
    assert extra.mean() == pytest.approx(scale / 2, rel=0.03)
    for share in (0.5, 0.9, 0.99):
        quantile = scale * ((1 - share) ** (-1 / 3) - 1)
        assert np.quantile(extra, share) == pytest.approx(quantile, rel=0.06)


def test_jitter_in_bursts_stalls_the_link_then_delivers_all_at_once() -> None:
    extra = delays_ms("delay=40ms,jitter=10ms,jitter_kind=bursts", 10 * PACKETS) - 40
    assert extra.min() == 0
    assert np.mean(extra > 0) == pytest.approx(0.1, abs=0.01)
    assert extra.std() == pytest.approx(10, rel=0.1)
    times = arrivals("delay=40ms,jitter=10ms,jitter_kind=bursts")
    assert times == sorted(time for time in times if time)
    held = [sent for sent, time in enumerate(times) if time and time > (sent + 40) * MS]
    assert len({times[sent] for sent in held}) < len(held) / 10


def test_random_loss_has_its_share_and_no_memory() -> None:
    runs = runs_of_loss("loss=5%")
    assert sum(runs) / PACKETS == pytest.approx(0.05, rel=0.1)
    assert np.mean(runs) == pytest.approx(1 / 0.95, rel=0.03)


@pytest.mark.parametrize("share", [0.05, 0.4])
def test_loss_in_bursts_has_its_share_and_its_length(share: float) -> None:
    runs = runs_of_loss(f"burst_loss.share={share},burst_loss.length=20ms", 10 * PACKETS)
    assert sum(runs) / (10 * PACKETS) == pytest.approx(share, rel=0.1)
    # A burst between two packets loses none; the others have no memory either.
    assert np.mean(runs) == pytest.approx(1 / (1 - math.exp(-1 / 20)), rel=0.1)


def test_a_share_of_packets_is_overtaken_by_as_many_as_were_sent_meanwhile() -> None:
    times = np.array(arrivals("delay=40ms,reorder.share=5%,reorder.by=10.5ms"))
    order = np.argsort(times, kind="stable")
    late = np.flatnonzero(times > (np.arange(PACKETS) + 40) * MS)
    assert len(late) / PACKETS == pytest.approx(0.05, rel=0.1)
    place = np.empty(PACKETS, int)
    place[order] = np.arange(PACKETS)
    # Ten packets pass it, except those that are late themselves.
    depth = place[late] - late
    assert depth.max() == 10
    assert depth.mean() == pytest.approx(10 * (1 - 2 * 0.05 * 0.95), rel=0.1)


def test_a_rate_limit_queues_and_loses_what_would_wait_too_long() -> None:
    # 100 bytes a millisecond are 800 kbit/s, twice what goes through.
    times = arrivals("delay=40ms,rate=400kbit/s", 2000)
    through = [time for time in times if time is not None]
    assert set(np.diff(through)) == {2 * MS}
    assert len(through) / len(times) == pytest.approx(0.5, abs=0.06)
    waits = [time / MS - sent for sent, time in enumerate(times) if time]
    assert waits[0] == 42
    assert max(waits) == pytest.approx(240, abs=3)
    assert set(delays_ms("rate=1600kbit/s", 100)) == {0.5}


def test_the_delay_changes_with_the_route_and_is_none_without_properties() -> None:
    assert arrivals("", 1000) == [sent * MS for sent in range(1000)]
    times = arrivals("delay=40ms,route_change.at=50ms,route_change.by=30ms", 100)
    assert times == [(sent + (40 if sent < 50 else 70)) * MS for sent in range(100)]
    shorter = arrivals("delay=40ms,route_change.at=50ms,route_change.by=-60ms", 100)
    assert shorter[49:51] == [89 * MS, 50 * MS]


def test_packets_of_a_regular_stall_arrive_at_its_end() -> None:
    times = arrivals("delay=40ms,stall.for=30ms,stall.every=100ms", 200)
    expected = [sent + 40 if sent % 100 < 70 else sent // 100 * 100 + 140 for sent in range(200)]
    assert times == [time_ms * MS for time_ms in expected]
    reason = refusal_of(SceneError, lambda: parse_link("stall.for=2s,stall.every=1s"))
    assert "every must be longer than for" in reason


def test_a_wandering_delay_stays_within_its_range_and_changes_slowly() -> None:
    text = "delay=40ms,wander.by=30ms,wander.over=500ms"
    delays = np.array(delays_ms(text, 20_000), float)
    assert delays[0] == 40
    assert 40 <= delays.min() < 45
    assert 65 < delays.max() <= 70
    # By 30 ms in 500 ms at most.
    assert np.abs(np.diff(delays)).max() <= 30 / 500 + 1e-6
    assert list(delays_ms(text, 20_000)) == delays.tolist()


def test_nothing_comes_through_a_cut_and_times_count_from_the_links_beginning() -> None:
    times = arrivals("delay=40ms,cut.from=50ms,cut.for=30ms", 100)
    assert [sent for sent, time in enumerate(times) if time is None] == list(range(50, 80))
    began_ns = 10**15
    text = "cut.from=50ms,cut.for=30ms,route_change.at=90ms,route_change.by=5ms"
    direction = Direction(parse_link(text), 1, began_ns)
    times = [direction.arrival_ns(began_ns + sent * MS, BYTES) for sent in range(100)]
    assert [sent for sent, time in enumerate(times) if time is None] == list(range(50, 80))
    assert times[89:91] == [began_ns + 89 * MS, began_ns + 95 * MS]


def test_the_same_seed_gives_the_same_arrivals() -> None:
    text = "delay=40ms,jitter=10ms,loss=10%,burst_loss.share=5%,burst_loss.length=20ms"
    assert arrivals(text, 500, seed=1) == arrivals(text, 500, seed=1)
    assert arrivals(text, 500, seed=1) != arrivals(text, 500, seed=2)


def test_control_is_never_lost_and_waits_for_the_end_of_a_cut() -> None:
    link = MessageLink(parse_link("delay=40ms,loss=100%,cut.from=50ms,cut.for=30ms"), 1)
    assert link.control_arrival_ns(0, BYTES) == 40 * MS
    assert link.control_arrival_ns(60 * MS, BYTES) == 120 * MS
    assert [link.data_arrival_ns(90 * MS, BYTES) for _ in range(3)] == [None] * 3
    assert link.lost_data == 3


def test_a_set_point_and_its_answer_are_lost_as_data_is() -> None:
    lossy = MessageLink(parse_link("delay=40ms,loss=20%"), 1)
    arrivals = [lossy.press_arrival_ns(ms * MS, BYTES) for ms in range(1_000)]
    assert 150 < arrivals.count(None) < 250
    assert {at_ns for at_ns in arrivals if at_ns} == {(ms + 40) * MS for ms in range(1_000)} - {
        (ms + 40) * MS for ms, at_ns in enumerate(arrivals) if at_ns is None
    }
    # They are no data: the account of lost frames does not contain them.
    assert lossy.lost_data == 0
    cut = MessageLink(parse_link("delay=40ms,cut.from=50ms,cut.for=30ms"), 1)
    assert cut.press_arrival_ns(60 * MS, BYTES) is None
    tcp = MessageLink(parse_link("delay=40ms,loss=20%,transport=tcp"), 1)
    assert None not in [tcp.press_arrival_ns(ms * MS, BYTES) for ms in range(200)]


def test_over_tcp_control_does_not_wait_for_data() -> None:
    link = MessageLink(parse_link("delay=40ms,cut.from=50ms,cut.for=1ms,transport=tcp"), 1)
    assert link.data_arrival_ns(40 * MS, BYTES) == 80 * MS
    assert link.data_arrival_ns(50 * MS, BYTES) == (51 + 10 + 100 + 40) * MS
    assert link.control_arrival_ns(60 * MS, BYTES) == 100 * MS
    assert link.data_arrival_ns(60 * MS, BYTES) == (51 + 10 + 100 + 40) * MS
    assert link.lost_data == 0


def tcp_delays_ms(text: str, messages: int) -> list[float]:
    """Return the time from each message to its reading at the other end."""
    stream = TcpStream(Direction(parse_link("delay=20ms," + text), 1))
    sent_ms = range(0, STEP * messages, STEP)
    return [stream.arrival_ns(sent * MS, 100) / MS - sent for sent in sent_ms]


def test_one_lost_packet_holds_up_all_that_follow_until_it_is_repeated() -> None:
    delays = tcp_delays_ms("cut.from=200ms,cut.for=2ms", 40)
    # The link is up at 202 ms; the next message's acknowledgement reveals the loss, a quarter of a
    # round trip late.
    repeated_ms = 202 + STEP + 1.25 * 40
    held = [repeated_ms + 20 - sent for sent in range(200, 262, STEP)]
    assert delays == [20] * 20 + held + [20] * (20 - len(held))


def test_in_a_long_cut_the_timeout_doubles_and_all_comes_soon_after_its_end() -> None:
    delays = tcp_delays_ms("cut.from=200ms,cut.for=940ms", 200)
    # Retransmitted after 240 ms and 480 ms later. 960 ms later would be too late: a message sent
    # after the cut is acknowledged before. If the timeout did not double, it would arrive sooner.
    assert delays[20] == 940 + STEP + 50 + 20
    # The others that were lost arrive with it, and the following messages wait for them.
    assert delays[21:119] == [delays[20] - STEP * later for later in range(1, 99)]
    assert delays[160:] == [20] * 40


@pytest.mark.parametrize("jitter_kind", ["gaussian", "pareto", "bursts"])
def test_nothing_is_lost_and_nothing_overtakes(jitter_kind: str) -> None:
    text = f"jitter=10ms,jitter_kind={jitter_kind},loss=5%,reorder.share=5%,reorder.by=50ms"
    stream = TcpStream(Direction(parse_link(text), 1))
    arrivals = [stream.arrival_ns(sent * STEP * MS, 100) for sent in range(5000)]
    assert arrivals == sorted(arrivals)
    assert all(arrival >= sent * STEP * MS for sent, arrival in enumerate(arrivals))
    assert arrivals[-1] < (5000 * STEP + 2000) * MS


def test_without_loss_a_message_takes_the_links_delay_and_waits_at_too_low_a_rate() -> None:
    assert tcp_delays_ms("", 100) == [20] * 100
    # 100 bytes each 10 ms are 80 kbit/s.
    assert tcp_delays_ms("rate=40kbit/s", 100) == [20 + 20 + STEP * later for later in range(100)]
