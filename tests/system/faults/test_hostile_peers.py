"""Peers that send garbage, floods or endless subscriptions: playback continues, nothing grows."""

import random
import time
from pathlib import Path

import pytest

from protocol.security.budgets import SUBSCRIPTION
from protocol.sockets import control_address
from sensing_node.control_server import REQUESTS_AT_ONCE
from telepulse.processes import free_addresses
from tests.support.felt_force import assert_limits_kept
from tests.support.hostile_peers import (
    flood_with_requests,
    port_of,
    send_garbage,
    subscribe_endlessly,
)
from tests.support.node_rig import node_rig, unaccounted
from tests.support.waiting import until

CONNECTIONS, MESSAGES, SILENT = 60, 400, 500
FLOODED_S = 2.0
SUBSCRIBING_S = 0.6
TOPIC_BYTES = (10, 200, 900)
# Without a limit the growth is hundreds of megabytes.
GROWN_BYTES = 40_000_000


@pytest.mark.parametrize(
    ("scene", "garbage", "grown_bytes"),
    [("radial", False, GROWN_BYTES), ("three_fingers", True, 60_000_000)],
)
def test_hostile_peers_on_every_port_cost_the_nodes_little_and_the_pulse_nothing(
    scene: str, garbage: bool, grown_bytes: int, tmp_path: Path
) -> None:
    rng = random.Random(5)
    with node_rig(tmp_path, scene=scene) as rig:
        (rig.telemetry_address,) = free_addresses(1)
        sensing, display, felt = rig.play()
        (data,) = rig.connect
        before_bytes = [node.rss_bytes() for node in (sensing, display)]
        for port in map(port_of, (data, rig.telemetry_address, control_address(data))):
            if garbage:
                send_garbage(port, CONNECTIONS, MESSAGES, SILENT, rng)
                continue
            for topic_bytes in TOPIC_BYTES:
                subscribe_endlessly(port, topic_bytes, SUBSCRIBING_S)
        for node, before in zip((sensing, display), before_bytes, strict=True):
            assert node.rss_bytes() - before < grown_bytes
        rig.await_played(felt, 500)
        sent, summary = sensing.end(), display.summary()
    assert unaccounted(sent, summary) == summary.samples.lost == 0
    if garbage:
        assert sent.faults == summary.faults == []
        assert summary.rejected == summary.rejected_readers == {}
        # What arrived on the control port was distinguished from displays' messages, and counted.
        assert sum(sent.rejected.values()) > MESSAGES / 4
    else:
        assert set(sent.rejected) == set(summary.rejected_readers) == {SUBSCRIPTION}
        assert summary.rejected == {}
    assert_limits_kept(felt)


def test_a_flood_of_frames_is_counted_and_cut_off(tmp_path: Path) -> None:
    with node_rig(tmp_path) as rig:
        felt, display = rig.felt(), rig.display()
        sensing = rig.sense("flood=data")
        until(lambda: felt.status and felt.status.summary["rejected"].get("flood"))
        # The flood goes on for another half second of the display's ticks.
        assert felt.first_ns(time.perf_counter_ns() + 500_000_000, within_s=10, felt=False)
        summary = display.end()
        sensing.end()
    assert summary.rejected["flood"] > 0
    # No more is processed than may queue, and the admitted rate.
    assert 0 < summary.rejected["duplicate"] < 30_000
    assert summary.faults == []


def test_of_endless_clock_requests_few_are_read(tmp_path: Path) -> None:
    with node_rig(tmp_path) as rig:
        sensing, display, _ = rig.play()
        flood_with_requests(rig.connect[0], FLOODED_S)
        summary, sent = display.end(), sensing.end()
    assert sent.rejected["held_back"] > 0
    # The budget of two displays: what may arrive at once, and 1 200 a second.
    assert sent.rejected["flood"] < REQUESTS_AT_ONCE + 2 * FLOODED_S * 1_200
    assert summary.samples.lost == 0
    assert summary.faults == []
