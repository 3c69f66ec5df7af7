import pytest

from protocol.errors import SceneError
from telepulse.simulation.link_model import parse_link

EVERYTHING = (
    "delay=40ms,jitter=10ms,jitter_kind=pareto,loss=1%,burst_loss.share=2%,burst_loss.length=50ms,"
    "reorder.share=3%,reorder.by=20ms,rate=2Mbit/s,route_change.at=5s,route_change.by=-10ms,"
    "cut.from=7s,cut.for=1.5s,transport=tcp"
)


def test_a_link_is_read_as_people_write_it() -> None:
    link = parse_link("delay=40ms,jitter=10ms,loss=1%")
    assert (link.delay_ns, link.jitter_ns, link.loss) == (40_000_000, 10_000_000, 0.01)
    assert parse_link(" delay = 1 s ") == parse_link("delay=1000ms")


def test_everything_a_link_can_do_is_read_and_written() -> None:
    link = parse_link(EVERYTHING)
    assert link.burst_loss is not None
    assert (link.burst_loss.share, link.burst_loss.length_ns) == (0.02, 50_000_000)
    assert link.reorder is not None
    assert (link.reorder.share, link.reorder.by_ns) == (0.03, 20_000_000)
    assert link.rate_bit_per_s == 2e6
    assert link.route_change is not None
    assert (link.route_change.at_ns, link.route_change.by_ns) == (5_000_000_000, -10_000_000)
    assert link.cut is not None
    assert (link.cut.from_ns, link.cut.for_ns) == (7_000_000_000, 1_500_000_000)
    assert (link.jitter_kind, link.transport) == ("pareto", "tcp")


@pytest.mark.parametrize("text", ["", "delay=40ms,loss=1%", "cut.from=1s,cut.for=1s", EVERYTHING])
def test_what_is_written_is_read_as_the_same(text: str) -> None:
    link = parse_link(text)
    assert parse_link(link.text()) == link


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("delay=40", ["delay", "time"]),
        ("delay=40N", ["delay", "time"]),
        ("delay=-1ms", ["delay", "greater"]),
        ("loss=2", ["loss", "less"]),
        ("loss=much", ["loss", "ratio"]),
        ("dealy=1ms", ["dealy", "unknown key", "did you mean delay?"]),
        ("delay", ["delay", "time"]),
        ("jitter_kind=paretto", ["jitter_kind", "gaussian", "pareto", "bursts"]),
        ("transport=udp", ["transport", "datagram", "tcp"]),
        ("rate=2MHz", ["rate", "bit rate", "Mbit/s"]),
        ("rate=1bit/s", ["rate", "greater than or equal to 1000"]),
        ("cut=3s", ["cut", "table"]),
        ("cut=3s,cut.from=3s", ["cut", "table"]),
        ("cut.from=3s", ["cut.for", "missing"]),
        ("cut.from=3s,cut.to=4s", ["cut.to", "unknown key"]),
        ("burst_loss.share=100%,burst_loss.length=50ms", ["burst_loss.share", "less than 1"]),
        ("burst_loss.share=1%,burst_loss.length=0s", ["burst_loss.length", "greater than 0"]),
        ("reorder.share=1%", ["reorder.by", "missing"]),
        ("transport=tcp,loss=100%", ["tcp", "loss"]),
    ],
)
def test_a_bad_link_is_one_line_that_says_what(text: str, words: list[str]) -> None:
    with pytest.raises(SceneError) as caught:
        parse_link(text)
    line = str(caught.value)
    assert "\n" not in line
    for word in (text, *words):
        assert word in line
