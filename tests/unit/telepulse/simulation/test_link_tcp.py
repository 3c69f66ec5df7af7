"""Messages over TCP in virtual time, one each 10 ms, 20 ms away: a round trip of 40 ms."""

import pytest

from telepulse.simulation.link_model import Direction, TcpStream, parse_link

MS = 1_000_000
STEP = 10


def delays_ms(text: str, messages: int) -> list[float]:
    """How long each message takes to be read at the other end."""
    stream = TcpStream(Direction(parse_link("delay=20ms," + text), 1))
    sent_ms = range(0, STEP * messages, STEP)
    return [stream.arrival_ns(sent * MS, 100) / MS - sent for sent in sent_ms]


def test_without_loss_a_message_takes_the_links_delay() -> None:
    assert delays_ms("", 100) == [20] * 100


def test_one_lost_packet_holds_up_all_that_follow_until_it_is_repeated() -> None:
    delays = delays_ms("cut.from=200ms,cut.for=2ms", 40)
    # Alive at 202 ms, and noticed by the next message's acknowledgement a quarter late.
    repeated_ms = 202 + STEP + 1.25 * 40
    held = [repeated_ms + 20 - sent for sent in range(200, 262, STEP)]
    assert delays == [20] * 20 + held + [20] * (20 - len(held))


def test_in_a_long_cut_the_timeout_doubles_and_all_comes_soon_after_its_end() -> None:
    delays = delays_ms("cut.from=200ms,cut.for=940ms", 200)
    # It is tried after 240 ms and 480 ms later; 960 ms later would be too late, as what is sent
    # after the cut is acknowledged before. If the timeout did not double, it would come sooner.
    assert delays[20] == 940 + STEP + 50 + 20
    # The others that were lost come with it, and what follows waits for them.
    assert delays[21:119] == [delays[20] - STEP * later for later in range(1, 99)]
    assert delays[160:] == [20] * 40


def test_what_waits_for_a_timeout_to_come_through_follows_a_round_trip_later() -> None:
    delays = delays_ms("cut.from=200ms,cut.for=239ms", 100)
    # The timeout's repeat at 440 ms is the first that comes through.
    assert delays[20] == 240 + 20
    # What was lost after it is known to be lost when that is acknowledged.
    assert delays[21] == 240 + 40 + 20 - STEP
    assert delays[22] == delays[21] - STEP
    assert delays[60:] == [20] * 40


@pytest.mark.parametrize("jitter_kind", ["gaussian", "pareto", "bursts"])
def test_nothing_is_lost_and_nothing_overtakes(jitter_kind: str) -> None:
    text = f"jitter=10ms,jitter_kind={jitter_kind},loss=5%,reorder.share=5%,reorder.by=50ms"
    stream = TcpStream(Direction(parse_link(text), 1))
    arrivals = [stream.arrival_ns(sent * STEP * MS, 100) for sent in range(5000)]
    assert arrivals == sorted(arrivals)
    assert all(arrival >= sent * STEP * MS for sent, arrival in enumerate(arrivals))
    assert arrivals[-1] < (5000 * STEP + 2000) * MS


def test_a_sender_waits_where_the_rate_is_too_low() -> None:
    # 100 bytes each 10 ms are 80 kbit/s.
    assert delays_ms("rate=40kbit/s", 100) == [20 + 20 + STEP * later for later in range(100)]


def test_a_connection_of_few_messages_finds_a_loss_by_its_timeout() -> None:
    stream = TcpStream(Direction(parse_link("delay=20ms,cut.from=0s,cut.for=1ms"), 1))
    assert stream.arrival_ns(0, 100) == (240 + 20) * MS
