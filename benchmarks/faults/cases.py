"""The faults. Each is made several times at random instants, until the pulse is felt again."""

import os
import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from benchmarks.load.many_displays import DisplayTimings, run_many_displays
from benchmarks.load.run import receive
from benchmarks.timing import process, spawn
from protocol.sockets import control_address
from telepulse.processes import free_addresses
from telepulse.simulation.link_scene import parse_link
from tests.support.felt_force import FeltForce
from tests.support.hostile_peers import deaf_subscriber, port_of, send_garbage
from tests.support.netem import emulate
from tests.support.node_rig import Node, node_rig, sequence_monitor, unaccounted

WHOLE = parse_link("delay=20ms,jitter=3ms")
CUT = parse_link("loss=100%")
BETWEEN_S = (0.2, 1.2)
BACK_WITHIN_S = 30.0
SUSPENDED_S = 2.0
WATCHED_S = 5.0
LISTENERS, CLOCK_MS = 18, 50
CONNECTIONS, MESSAGES, SILENT = 500, 2_000, 3_000


@dataclass(frozen=True, slots=True)
class FaultResult:
    """Figures of one fault, over all the times it was made.

    back_ms: times from the fault's end until the pulse was felt again. felt: share of the fault's
    time in which the pulse was felt, where it should be. unaccounted: samples that are in no count.
    peaks: see `FeltForce.peaks`.
    """

    unaccounted: int
    peaks: tuple[float, float, float]
    back_ms: tuple[float, ...] = ()
    felt: float | None = None


Case = Callable[[Path, int, random.Random], FaultResult]


def repeat(
    felt: FeltForce,
    times: int,
    rng: random.Random,
    fault: Callable[[], int],
    between_s: tuple[float, float] = BETWEEN_S,
) -> tuple[float, ...]:
    """Make a fault several times; return the times in ms until the pulse was felt again.

    fault: makes the fault and returns the time of its end in ns. between_s: range of the time
    before each.
    """
    back_ms = []
    for _ in range(times):
        time.sleep(rng.uniform(*between_s))
        ended_ns = fault()
        felt_ns = felt.steady_from_ns(ended_ns, BACK_WITHIN_S)
        back_ms.append(BACK_WITHIN_S * 1e3 if felt_ns is None else (felt_ns - ended_ns) * 1e-6)
    return tuple(back_ms)


def sensing_node_killed(folder: Path, times: int, rng: random.Random) -> FaultResult:
    """Kill the sensing node with SIGKILL; the fault ends when its successor listens.

    A killed node leaves no count of its samples: the display is compared with a sequence monitor.
    """
    with emulate(WHOLE) as link, node_rig(folder, link) as rig:
        with link.display.entered():
            sessions = rig.stack.enter_context(sequence_monitor(rig.connect[0]))
        sensing, display, felt = rig.play()

        def kill() -> int:
            nonlocal sensing
            sensing.kill()
            sensing.wait()
            sensing = rig.sense()
            return sensing.listening_ns

        back_ms = repeat(felt, times, rng, kill)
        sensing.end()
        samples = display.summary().samples
    missing = sum(sessions.values()) - (samples.sent or 0) - (samples.before_joining or 0)
    return FaultResult(max(0, missing), felt.peaks(), back_ms)


def display_killed(folder: Path, times: int, rng: random.Random) -> FaultResult:
    """Kill the display with SIGKILL; the fault ends when its successor waits for the stream."""
    with emulate(WHOLE) as link, node_rig(folder, link) as rig:
        sensing, display, felt = rig.play()

        def kill() -> int:
            nonlocal display
            display.kill()
            display.wait()
            display = rig.display()
            return display.listening_ns

        back_ms = repeat(felt, times, rng, kill)
        return FaultResult(unaccounted(sensing.end(), display.summary()), felt.peaks(), back_ms)


def link_cut(folder: Path, times: int, rng: random.Random) -> FaultResult:
    """Cut the link for 0.3 to 8 s."""
    with emulate(WHOLE) as link, node_rig(folder, link) as rig:
        sensing, display, felt = rig.play()

        def cut() -> int:
            link.change(CUT)
            time.sleep(rng.uniform(0.3, 8.0))
            link.change(WHOLE)
            return time.perf_counter_ns()

        back_ms = repeat(felt, times, rng, cut)
        return FaultResult(unaccounted(sensing.end(), display.summary()), felt.peaks(), back_ms)


def display_killed_in_a_cut(folder: Path, times: int, rng: random.Random) -> FaultResult:
    """Restart the display while the link is cut: it has no state of that network."""
    with emulate(WHOLE) as link, node_rig(folder, link) as rig:
        sensing, display, felt = rig.play()

        def cut() -> int:
            nonlocal display
            link.change(CUT)
            display.kill()
            display.wait()
            display = rig.display()
            time.sleep(rng.uniform(0.0, 8.0))
            link.change(WHOLE)
            return time.perf_counter_ns()

        back_ms = repeat(felt, times, rng, cut)
        return FaultResult(unaccounted(sensing.end(), display.summary()), felt.peaks(), back_ms)


def display_stopped_in_a_cut(folder: Path, times: int, rng: random.Random) -> FaultResult:
    """Stop the display at most 0.2 s before its link is cut.

    It continues when the link is restored, or up to 0.6 s before or after.
    """
    with emulate(WHOLE) as link, node_rig(folder, link) as rig:
        sensing, display, felt = rig.play()

        def restore() -> None:
            link.change(WHOLE)

        def cut() -> int:
            apart_s = rng.uniform(-0.6, 0.6)
            display.pause()
            time.sleep(rng.uniform(0.0, 0.2))
            link.change(CUT)
            time.sleep(rng.uniform(0.5, 4.0))
            ends = (display.resume, restore) if apart_s < 0 else (restore, display.resume)
            ends[0]()
            time.sleep(abs(apart_s))
            ends[1]()
            return time.perf_counter_ns()

        back_ms = repeat(felt, times, rng, cut)
        return FaultResult(unaccounted(sensing.end(), display.summary()), felt.peaks(), back_ms)


def one_of_two_networks_cut(folder: Path, times: int, rng: random.Random) -> FaultResult:
    """Cut the two networks alternately, for 0.5 to 3 s."""
    with emulate(WHOLE, WHOLE) as link, node_rig(folder, link) as rig:
        sensing, display, felt = rig.play()
        began_ns = time.perf_counter_ns()
        for number in range(times):
            link.change(CUT, number % 2)
            time.sleep(rng.uniform(0.5, 3.0))
            link.change(WHOLE, number % 2)
            # Time until the network carries frames again; it may have to be reconnected.
            time.sleep(3.0)
        share = felt.share(began_ns, time.perf_counter_ns())
        missing = unaccounted(sensing.end(), display.summary())
        return FaultResult(missing, felt.peaks(), felt=share)


def display_stopped(folder: Path, times: int, rng: random.Random) -> FaultResult:
    """Stop one display for 0.5 to 20 s; `felt` is measured at another one."""
    with node_rig(folder) as rig:
        sensing, display, felt = rig.play()
        other = rig.display("other")
        felt_at_other = rig.felt("other")
        began_ns = felt_at_other.first_ns(other.listening_ns, BACK_WITHIN_S) or 0

        def stop() -> int:
            display.pause()
            time.sleep(rng.uniform(0.5, 20.0))
            display.resume()
            return time.perf_counter_ns()

        back_ms = repeat(felt, times, rng, stop)
        share = felt_at_other.share(began_ns, time.perf_counter_ns())
        sent = sensing.end()
        missing = unaccounted(sent, display.summary()) + unaccounted(sent, other.summary())
        return FaultResult(missing, felt.peaks(), back_ms, share)


def one_of_twenty_never_reads(folder: Path, times: int, rng: random.Random) -> FaultResult:
    """Play a display beside eighteen listeners in one process and one that never reads."""
    with node_rig(folder) as rig:
        sensing, display, felt = rig.play()
        ours, theirs = spawn.Pipe()
        arguments = rig.connect[0], LISTENERS, CLOCK_MS, None, theirs
        rig.stack.enter_context(process(run_many_displays, *arguments))
        receive(ours)
        ours.send(times * WATCHED_S)
        began_ns = time.perf_counter_ns()
        for _ in range(times):
            with deaf_subscriber(port_of(rig.connect[0])):
                time.sleep(WATCHED_S)
        share = felt.share(began_ns, time.perf_counter_ns())
        timings: DisplayTimings = receive(ours)
        # For a listener, frames that do not arrive are unaccounted for.
        missing = unaccounted(sensing.end(), display.summary()) + timings.lost
        return FaultResult(missing, felt.peaks(), felt=share)


def flooded(port: str) -> Case:
    """Return the case of garbage on the "data", "control" or "telemetry" port."""

    def case(folder: Path, times: int, rng: random.Random) -> FaultResult:
        with node_rig(folder) as rig:
            (rig.telemetry_address,) = free_addresses(1)
            sensing, display, felt = rig.play()
            (data,) = rig.connect
            addresses = {"data": data, "control": control_address(data)}
            number = port_of(addresses.get(port, rig.telemetry_address))
            began_ns = time.perf_counter_ns()
            with without_realtime():
                for _ in range(times):
                    send_garbage(number, CONNECTIONS, MESSAGES, SILENT, rng)
            share = felt.share(began_ns, time.perf_counter_ns())
            missing = unaccounted(sensing.end(), display.summary())
            return FaultResult(missing, felt.peaks(), felt=share)

    return case


def suspended(host: str) -> Case:
    """Return the case of a suspended "sensing" or "display" host, whose clock stops with it."""

    def case(folder: Path, times: int, rng: random.Random) -> FaultResult:
        with node_rig(folder) as rig:
            sensing, display, felt = rig.play(f"step={-SUSPENDED_S}")
            node: Node = sensing if host == "sensing" else display
            behind_ns = 0

            def suspend() -> int:
                nonlocal behind_ns
                node.pause()
                time.sleep(SUSPENDED_S)
                node.step_clock()
                node.resume()
                behind_ns += round(SUSPENDED_S * 1e9) if node is display else 0
                return time.perf_counter_ns() - behind_ns

            back_ms = repeat(felt, times, rng, suspend)
            missing = unaccounted(sensing.end(), display.summary())
            return FaultResult(missing, felt.peaks(), back_ms)

    return case


@contextmanager
def without_realtime() -> Iterator[None]:
    """Run this process without real-time priority.

    A hostile peer stands for another machine's: it must take no processor time from nodes that
    inherited such a priority from this process.
    """
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, priority)


CASES: dict[str, Case] = {
    "sensing node: kill -9, started again": sensing_node_killed,
    "display: kill -9, started again": display_killed,
    "link cut for 0.3 to 8 s": link_cut,
    "display: kill -9, started again in a cut": display_killed_in_a_cut,
    "display stopped in a cut": display_stopped_in_a_cut,
    "one of two networks cut for 0.5 to 3 s": one_of_two_networks_cut,
    "display stopped for 0.5 to 20 s": display_stopped,
    "one of 20 displays never reads": one_of_twenty_never_reads,
    "garbage on the data port": flooded("data"),
    "garbage on the control port": flooded("control"),
    "garbage on the telemetry port": flooded("telemetry"),
    "sensing host suspended for 2 s": suspended("sensing"),
    "display host suspended for 2 s": suspended("display"),
}
NEEDS_EMULATOR = {
    sensing_node_killed,
    display_killed,
    link_cut,
    display_killed_in_a_cut,
    display_stopped_in_a_cut,
    one_of_two_networks_cut,
}
