"""Garbage on every port of both nodes: what was felt goes on, and nothing grows."""

import random
import time
from pathlib import Path

import zmq

from benchmarks.faults.flood import flooding_display, run
from benchmarks.faults.hostile import (
    garbage_messages,
    port_of,
    raw_garbage,
    silent_connections,
)
from benchmarks.faults.stage import staged, unaccounted
from protocol.sockets import control_address
from sensing_node.control_server import REQUESTS_AT_ONCE
from telepulse.processes import free_addresses
from tests.support.felt_force import assert_limits_kept

RAW, MESSAGES, SILENT = 60, 400, 500
KINDS = (zmq.DEALER, zmq.XSUB, zmq.PUB)
PLAYED = 500
GROWN_BYTES = 60_000_000
FLOODED_S = 2.0


def test_garbage_on_every_port_changes_nothing(tmp_path: Path) -> None:
    rng = random.Random(5)
    with staged(tmp_path) as stage:
        (stage.telemetry_address,) = free_addresses(1)
        sensing, display, finger = stage.play()
        (data,) = stage.connect
        held_bytes = [node.rss_bytes() for node in (sensing, display)]
        for address in (data, control_address(data), stage.telemetry_address):
            with silent_connections(port_of(address), SILENT):
                raw_garbage(port_of(address), RAW, rng)
                for kind in KINDS:
                    garbage_messages(port_of(address), kind, MESSAGES, rng)
        stage.await_played(finger, PLAYED)
        for node, before_bytes in zip((sensing, display), held_bytes, strict=True):
            assert node.rss_bytes() - before_bytes < GROWN_BYTES
        sent, account = sensing.end(), display.account()
    assert unaccounted(sent, account) == 0
    assert account.samples.lost == 0
    assert account.rejected == {}
    # What came over the control port was told from what displays say, and counted.
    assert sum(sent.rejected.values()) > MESSAGES / 2
    assert sent.faults == account.faults == []
    assert_limits_kept(finger)


def test_a_sensing_node_that_sends_all_frames_hundreds_of_times_is_closed_out(
    tmp_path: Path,
) -> None:
    display = run(tmp_path, "data", lambda address: time.sleep(FLOODED_S)).display
    assert display.rejected["flood"] > 0
    # No more is processed than what may queue, and the rate.
    assert 0 < display.rejected["duplicate"] < 30_000
    assert display.faults == []


def test_of_a_display_that_asks_without_end_few_questions_are_read(tmp_path: Path) -> None:
    def flood(address: str) -> None:
        end_s = time.monotonic() + FLOODED_S
        flooding_display(address, lambda: time.monotonic() > end_s)

    flooded = run(tmp_path, None, flood)
    sensing, display = flooded.sensing, flooded.display
    assert sensing.rejected["held_back"] > 0
    # Two displays: what may come at once, and 1 200 a second.
    assert sensing.rejected["flood"] < REQUESTS_AT_ONCE + 2 * FLOODED_S * 1_200
    assert display.samples.lost == 0
    assert display.faults == []
