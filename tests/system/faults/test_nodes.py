"""Nodes that are killed, stopped or suspended, and displays that do not read."""

import random
import time
from dataclasses import asdict
from pathlib import Path

from protocol.config.scene_file import find_scene
from tests.support.felt_force import PATIENCE_S, assert_back_within_a_second, assert_limits_kept
from tests.support.hostile_peers import deaf_subscriber, port_of, queued_bytes
from tests.support.node_rig import Node, node_rig, sequence_monitor, unaccounted
from tests.support.nodes import assert_accounted
from tests.support.waiting import until

KILLS = 2
# Samples of a killed node's last messages that one peer may have received and another not.
LAST_SAMPLES = 10
STOPPED_S = 1.5
SUSPENDED_S = 0.8
# 1 kB frames, 200 a second; the kernel queues twice what it is asked to.
FAST = 'rate = "50 kHz"'
QUEUED_BYTES = 500_000
GROWN_BYTES = 20_000_000


def test_a_killed_sensing_node_is_felt_again_and_its_sessions_are_accounted_for(
    tmp_path: Path,
) -> None:
    rng, killed = random.Random(1), 0
    with (
        node_rig(tmp_path, scene="three_fingers") as rig,
        sequence_monitor(rig.connect[0]) as sessions,
    ):
        sensing, display, felt = rig.play()

        def kill() -> int:
            nonlocal sensing, killed
            time.sleep(rng.uniform(0, 0.4))
            killed, killed_ns = killed + 1, time.perf_counter_ns()
            sensing.kill()
            sensing.wait()
            assert felt.first_ns(killed_ns, PATIENCE_S, felt=False) is not None
            sensing = rig.sense()
            return sensing.listening_ns

        for _ in range(KILLS):
            assert_back_within_a_second(felt, kill)
        sent, summary = sensing.end().samples.sent, display.summary()
    samples = summary.samples
    assert samples.sent is not None
    assert samples.before_joining is not None
    assert_accounted(asdict(samples))
    assert len(sessions) == killed + 1
    assert list(sessions.values())[-1] == sent
    received = samples.sent + samples.before_joining
    assert abs(sum(sessions.values()) - received) <= LAST_SAMPLES * killed
    assert summary.faults == []
    assert_limits_kept(felt)


def test_a_restarted_display_feels_the_stream_that_continued_meanwhile(tmp_path: Path) -> None:
    rng = random.Random(2)
    with node_rig(tmp_path, scene="announce") as rig:
        sensing, display, felt = rig.play()

        def kill() -> int:
            nonlocal display
            time.sleep(rng.uniform(0, 0.4))
            display.kill()
            display.wait()
            # The counts of its last status add up.
            assert felt.status is not None
            assert_accounted(felt.status.summary["samples"])
            display = rig.display()
            return display.listening_ns

        assert_back_within_a_second(felt, kill)
        sent, summary = sensing.end(), display.summary()
    assert unaccounted(sent, summary) == 0
    assert (summary.samples.played or 0) > 0
    assert sent.faults == summary.faults == []
    assert_limits_kept(felt)


def test_a_stopped_display_resumes_at_the_present_and_another_loses_nothing(
    tmp_path: Path,
) -> None:
    with node_rig(tmp_path) as rig:
        sensing, display, felt = rig.play()
        other = rig.display("other")

        def stop() -> int:
            display.pause()
            time.sleep(STOPPED_S)
            display.resume()
            return time.perf_counter_ns()

        assert_back_within_a_second(felt, stop)
        sent = sensing.end()
        stopped, undisturbed = display.summary(), other.summary()
    for summary in (stopped, undisturbed):
        assert unaccounted(sent, summary) == 0
        assert summary.faults == []
    assert undisturbed.samples.lost == 0
    assert stopped.samples.late
    # Of 500 ticks a second.
    assert (stopped.loop.deadline_misses or 0) > STOPPED_S * 450
    # The pulse returned by a ramp of 0.3 s, although the newest samples had queued.
    assert (stopped.interruptions.count or 0) >= 1
    assert (stopped.interruptions.longest_s or 0.0) > STOPPED_S + 0.25
    assert_limits_kept(felt)


def test_the_pulse_of_hosts_that_were_suspended_is_felt_again(tmp_path: Path) -> None:
    """The monotonic clock of a suspended host steps; neither node reads the wall clock."""
    with node_rig(tmp_path) as rig:
        sensing, display, felt = rig.play(f"step={-SUSPENDED_S}")
        steps = {"sensing": 0, "display": 0}

        def suspend(node: Node, host: str) -> int:
            steps[host] += 1
            node.pause()
            time.sleep(SUSPENDED_S)
            # The process handles the signal as soon as it continues.
            node.step_clock()
            node.resume()
            # The traces are on the display's clock.
            return time.perf_counter_ns() - round(steps["display"] * SUSPENDED_S * 1e9)

        def steps_counted() -> int | None:
            return None if felt.status is None else felt.status.summary["clock"]["steps"]

        assert_back_within_a_second(felt, lambda: suspend(sensing, "sensing"))
        assert_back_within_a_second(felt, lambda: suspend(display, "display"))
        # The pulse is played, late, before a step is recognised as one.
        until(lambda: steps_counted() == sum(steps.values()))
        sent, summary = sensing.end(), display.summary()
    assert unaccounted(sent, summary) == 0
    assert summary.clock.steps == sum(steps.values())
    assert summary.faults == []
    assert_limits_kept(felt)


def test_a_display_that_never_reads_is_disconnected_before_much_has_queued(tmp_path: Path) -> None:
    with node_rig(tmp_path) as rig:
        rig.scene = tmp_path / "fast.toml"
        text = find_scene("radial").read_text(encoding="utf-8")
        rig.scene.write_text(text.replace('rate = "1 kHz"', FAST), encoding="utf-8")
        sensing = rig.sense()
        with (
            sequence_monitor(rig.connect[0]) as sessions,
            deaf_subscriber(port_of(rig.connect[0])) as deaf,
        ):
            before_bytes, queued = sensing.rss_bytes(), [0]
            end_s = time.monotonic() + PATIENCE_S
            while (now := queued_bytes(deaf)) is not None:
                assert time.monotonic() < end_s
                queued.append(now)
                time.sleep(0.05)
            assert max(queued) < QUEUED_BYTES
            assert sensing.rss_bytes() - before_bytes < GROWN_BYTES
            sent = sensing.end().samples.sent
        # Another subscriber received the whole stream.
        assert list(sessions.values()) == [sent]
