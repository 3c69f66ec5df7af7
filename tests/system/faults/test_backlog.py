"""Displays that do not read: what queues for them, and what others notice."""

import time
from pathlib import Path

import zmq

from benchmarks.faults.hostile import deaf_subscriber, port_of, queued_bytes
from benchmarks.faults.sequence_monitor import monitor_sequence
from benchmarks.faults.stage import staged, unaccounted
from protocol.config.scene_file import find_scene
from protocol.tactile import ElasticLayer
from protocol.wire.stream import Channel, StreamDescription
from sensing_node.node import MOST_BYTES, queue_limits
from tests.support.felt_force import PATIENCE_S, assert_back_within_a_second, assert_limits_kept

MS = 1_000_000
STOPPED_S = 1.5
# 1 kB frames, 200 a second; the kernel takes twice what it is asked for.
FAST = 'rate = "50 kHz"'
QUEUED_BYTES = 500_000
GROWN_BYTES = 20_000_000


def stream(period_ns: int, batch: int, channels: int = 1) -> StreamDescription:
    names = tuple(Channel(f"c{number}") for number in range(channels))
    return StreamDescription("s", period_ns, batch, names, ElasticLayer())


def test_about_a_second_of_a_stream_may_queue() -> None:
    assert queue_limits(stream(MS, 5))[zmq.SNDHWM] == 200
    assert queue_limits(stream(MS, 1))[zmq.SNDHWM] == 1000
    assert queue_limits(stream(1_000_000_000, 1))[zmq.SNDHWM] == 16
    # Kernels double it; small frames cost packets of their own, of about a kilobyte.
    assert 200_000 < 2 * queue_limits(stream(MS, 5))[zmq.SNDBUF] < 250_000
    # Where a second is more than a system grants on request, it is left to choose.
    assert zmq.SNDBUF not in queue_limits(stream(1_000, 1000, channels=8))
    assert queue_limits(stream(100_000, 50, channels=4))[zmq.SNDBUF] <= MOST_BYTES


def test_a_stopped_display_comes_back_to_the_present_and_another_misses_nothing(
    tmp_path: Path,
) -> None:
    with staged(tmp_path) as stage:
        sensing, display, finger = stage.play()
        other = stage.display("other")

        def stop() -> int:
            display.pause()
            time.sleep(STOPPED_S)
            display.resume()
            return time.monotonic_ns()

        assert_back_within_a_second(finger, stop)
        sent = sensing.end()
        account, undisturbed = display.account(), other.account()
    for summary in (account, undisturbed):
        assert unaccounted(sent, summary) == 0
        assert summary.faults == []
    assert undisturbed.samples.lost == 0
    assert account.samples.late
    assert (account.loop.deadline_misses or 0) > STOPPED_S * 900
    # By a ramp of 0.3 s, although the newest of the stream had queued.
    assert (account.interruptions.count or 0) >= 1
    assert (account.interruptions.longest_s or 0.0) > STOPPED_S + 0.25
    assert_limits_kept(finger)


def test_who_never_reads_is_let_go_before_much_has_queued(tmp_path: Path) -> None:
    scene = tmp_path / "fast.toml"
    text = find_scene("radial").read_text(encoding="utf-8")
    scene.write_text(text.replace('rate = "1 kHz"', FAST), encoding="utf-8")
    with staged(tmp_path) as stage:
        stage.scene = scene
        sensing = stage.sense()
        with (
            monitor_sequence(stage.connect[0]) as monitor,
            deaf_subscriber(port_of(stage.connect[0])) as deaf,
        ):
            held_bytes, queued = sensing.rss_bytes(), [0]
            end_s = time.monotonic() + PATIENCE_S
            while (now := queued_bytes(deaf)) is not None:
                assert time.monotonic() < end_s
                queued.append(now)
                time.sleep(0.05)
            assert max(queued) < QUEUED_BYTES
            assert sensing.rss_bytes() - held_bytes < GROWN_BYTES
            sent = sensing.end().samples.sent
        # The other one heard all of it to the end.
        assert list(monitor.sent.values()) == [sent]
