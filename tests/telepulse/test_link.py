import numpy as np
import pytest

from protocol.errors import SceneError
from telepulse.link import Link, LinkScene, parse_link


def test_a_link_is_read_as_people_write_it() -> None:
    link = parse_link("delay=40ms,jitter=10ms,loss=1%")
    assert (link.delay_ns, link.jitter_ns, link.loss) == (40_000_000, 10_000_000, 0.01)
    assert parse_link(" delay = 1 s ") == parse_link("delay=1000ms")
    assert parse_link(link.text()) == link


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("delay=40", "time"),
        ("delay=40N", "time"),
        ("delay=-1ms", "greater"),
        ("loss=2", "less"),
        ("loss=much", "ratio"),
        ("dealy=1ms", "unknown key"),
        ("delay", "time"),
    ],
)
def test_a_bad_link_is_one_line_that_says_what(text: str, word: str) -> None:
    with pytest.raises(SceneError, match=word) as caught:
        parse_link(text)
    assert "\n" not in str(caught.value)
    assert text in str(caught.value)


def test_delays_and_losses_have_the_stated_statistics() -> None:
    link = Link(parse_link("delay=40ms,jitter=10ms,loss=2%"), seed=1)
    delays_ms = np.array([link.delay_ns() for _ in range(20_000)]) * 1e-6
    assert delays_ms.mean() == pytest.approx(40, abs=0.3)
    assert delays_ms.std() == pytest.approx(10, abs=0.3)
    assert delays_ms.min() >= 0
    assert sum(link.loses() for _ in range(20_000)) == link.lost == pytest.approx(400, abs=80)


def test_a_link_without_properties_does_nothing() -> None:
    link = Link(LinkScene(), seed=1)
    assert link.delay_ns() == 0
    assert not any(link.loses() for _ in range(1000))


def test_the_same_seed_gives_the_same_fate() -> None:
    scene = parse_link("delay=40ms,jitter=10ms,loss=10%")

    def fate(seed: int) -> list[tuple[int, bool]]:
        link = Link(scene, seed)
        return [(link.delay_ns(), link.loses()) for _ in range(100)]

    assert fate(1) == fate(1)
    assert fate(1) != fate(2)
