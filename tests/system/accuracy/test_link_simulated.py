"""Every impairment in virtual time, through both nodes: every sample is accounted for."""

import dataclasses

import pytest

from protocol.run_summary import Summary
from telepulse.scene import load_scene
from telepulse.simulation.link_model import parse_link
from telepulse.simulation.virtual_time import simulate
from tests.support.nodes import RADIAL

SECONDS = 8
SAMPLES = 1000 * SECONDS


def play(text: str) -> Summary:
    scene = dataclasses.replace(load_scene(RADIAL), link=parse_link("delay=20ms," + text))
    return simulate(scene, SECONDS, seed=1)


def counts(summary: Summary) -> tuple[int, int, int]:
    """Played, late, lost; their sum is what was sent."""
    samples = summary.samples
    assert samples.played is not None
    assert samples.late is not None
    assert samples.lost is not None
    assert samples.sent == samples.played + samples.late + samples.lost == SAMPLES
    assert samples.before_joining == 0
    assert summary.rejected == {}
    assert summary.faults == []
    return samples.played, samples.late, samples.lost


@pytest.mark.parametrize(
    ("text", "late", "lost"),
    [
        ("", False, False),
        ("jitter=5ms", True, False),
        ("jitter=5ms,jitter_kind=pareto", True, False),
        ("jitter=5ms,jitter_kind=bursts", True, False),
        ("loss=2%", False, True),
        ("burst_loss.share=2%,burst_loss.length=50ms", False, True),
        ("reorder.share=0.5%,reorder.by=30ms", True, False),
        ("rate=1Mbit/s", False, False),
        ("route_change.at=4s,route_change.by=30ms", True, False),
        ("cut.from=4s,cut.for=1s", False, True),
    ],
)
@pytest.mark.parametrize("transport", ["datagram", "tcp"])
def test_each_impairment_makes_samples_late_or_lost(
    text: str, late: bool, lost: bool, transport: str
) -> None:
    summary = play(f"{text},transport={transport}")
    _, samples_late, samples_lost = counts(summary)
    if transport == "tcp":
        # What a datagram loses comes late; nothing overtakes.
        late, lost = late or lost, False
        assert summary.frames.reordered == 0
    assert (samples_late > 0, samples_lost > 0) == (late, lost)


def test_a_rate_below_the_streams_loses_datagrams_and_the_rest_waits_in_the_queue() -> None:
    summary = play("rate=100kbit/s")
    _, _, lost = counts(summary)
    assert lost > SAMPLES / 4
    assert summary.one_way_delay_ms.p50 is not None
    # By the true clock at most 20 + 200 ms and a frame's 9 ms; a clock exchange cannot tell that
    # only one way has a queue, and takes some of it for an offset.
    assert 120 < summary.one_way_delay_ms.p50 < 229


def test_a_cut_loses_as_much_as_was_sent_meanwhile() -> None:
    assert counts(play("cut.from=4s,cut.for=1s"))[2] == 1000
    summary = play("cut.from=4s,cut.for=1s,transport=tcp")
    assert summary.one_way_delay_ms.max == pytest.approx(1000 + 20 + 55, abs=10)


def test_over_tcp_a_loss_is_a_delay() -> None:
    free, lossy = (play(f"jitter=3ms,loss={loss},transport=tcp") for loss in ("0%", "2%"))
    assert free.one_way_delay_ms.p99 is not None
    assert lossy.one_way_delay_ms.p99 is not None
    assert lossy.one_way_delay_ms.p99 > 2 * free.one_way_delay_ms.p99
