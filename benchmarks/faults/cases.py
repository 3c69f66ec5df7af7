"""The faults: each is made many times, at instants drawn from a seed, and the pulse waited for."""

import json
import os
import random
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from subprocess import PIPE

import zmq

from benchmarks.faults.finger import Finger
from benchmarks.faults.hostile import (
    deaf_subscriber,
    garbage_messages,
    port_of,
    raw_garbage,
    silent_connections,
)
from benchmarks.faults.sequence_monitor import monitor_sequence
from benchmarks.faults.stage import Node, staged, unaccounted
from benchmarks.faults.stepped import STEP_VARIABLE
from protocol.host.child_process import ChildProcess
from protocol.sockets import control_address
from telepulse.netem import emulate
from telepulse.processes import free_addresses
from telepulse.simulation.link_model import parse_link

WHOLE = parse_link("delay=20ms,jitter=3ms")
CUT = parse_link("loss=100%")
BETWEEN_S = (0.2, 1.2)
BACK_WITHIN_S = 30.0
SUSPENDED_S = 2.0
WATCHED_S = 5.0
LISTENERS = 18
RAW, MESSAGES, SILENT = 500, 2_000, 3_000
STREAM_ENDS_WITHIN_S = 30.0


@dataclass(frozen=True, slots=True)
class Found:
    """The results of one fault, over all the times it was made.

    back_ms: from its end until the pulse was felt again, each time; felt: the share of the time
    it was felt while the fault lasted, where it should be. unaccounted: samples that no account
    names. The peaks are those of `Finger.peaks`.
    """

    unaccounted: int
    peaks: tuple[float, float, float]
    back_ms: tuple[float, ...] = ()
    felt: float | None = None


def again(
    finger: Finger, times: int, rng: random.Random, fault: Callable[[], int]
) -> tuple[float, ...]:
    """Make a fault so many times; how long the pulse took to be back, in ms.

    fault: returns when it ended, in ns.
    """
    back_ms = []
    for _ in range(times):
        time.sleep(rng.uniform(*BETWEEN_S))
        ended_ns = fault()
        felt_ns = finger.felt_steadily_from_ns(ended_ns, BACK_WITHIN_S)
        back_ms.append(BACK_WITHIN_S * 1e3 if felt_ns is None else (felt_ns - ended_ns) * 1e-6)
    return tuple(back_ms)


def sensing_node_killed(folder: Path, times: int, rng: random.Random) -> Found:
    """Kill -9 of the sensing node; it ends when the next one listens.

    A killed node leaves no count of its samples: the display is compared with a sequence monitor.
    """
    with emulate(WHOLE) as link, staged(folder, link) as stage:
        with link.display.entered():
            hearing = stage.stack.enter_context(monitor_sequence(stage.connect[0]))
        sensing, display, finger = stage.play()

        def kill() -> int:
            nonlocal sensing
            sensing.kill()
            sensing = stage.sense()
            return sensing.listening_ns

        back_ms = again(finger, times, rng, kill)
        sensing.end()
        samples = display.account().samples
    missing = sum(hearing.sent.values()) - (samples.sent or 0) - (samples.before_joining or 0)
    return Found(max(0, missing), finger.peaks(), back_ms)


def display_killed(folder: Path, times: int, rng: random.Random) -> Found:
    """Kill -9 of the display; it ends when the next one says that it waits."""
    with emulate(WHOLE) as link, staged(folder, link) as stage:
        sensing, display, finger = stage.play()

        def kill() -> int:
            nonlocal display
            display.kill()
            display = stage.display()
            return display.listening_ns

        back_ms = again(finger, times, rng, kill)
        return Found(unaccounted(sensing.end(), display.account()), finger.peaks(), back_ms)


def link_cut(folder: Path, times: int, rng: random.Random) -> Found:
    """A cut of 0.3 to 8 s."""
    with emulate(WHOLE) as link, staged(folder, link) as stage:
        sensing, display, finger = stage.play()

        def cut() -> int:
            link.change(CUT)
            time.sleep(rng.uniform(0.3, 8.0))
            link.change(WHOLE)
            return time.monotonic_ns()

        back_ms = again(finger, times, rng, cut)
        return Found(unaccounted(sensing.end(), display.account()), finger.peaks(), back_ms)


def display_killed_in_a_cut(folder: Path, times: int, rng: random.Random) -> Found:
    """The display is started again while the link is cut: of this network it knows nothing."""
    with emulate(WHOLE) as link, staged(folder, link) as stage:
        sensing, display, finger = stage.play()

        def cut() -> int:
            nonlocal display
            link.change(CUT)
            display.kill()
            display = stage.display()
            time.sleep(rng.uniform(0.0, 8.0))
            link.change(WHOLE)
            return time.monotonic_ns()

        back_ms = again(finger, times, rng, cut)
        return Found(unaccounted(sensing.end(), display.account()), finger.peaks(), back_ms)


def display_stopped_in_a_cut(folder: Path, times: int, rng: random.Random) -> Found:
    """SIGSTOP of the display at most 0.2 s before its link is cut; it goes on when the link does,
    or up to 0.6 s before or after.
    """
    with emulate(WHOLE) as link, staged(folder, link) as stage:
        sensing, display, finger = stage.play()

        def cut() -> int:
            apart_s = rng.uniform(-0.6, 0.6)
            display.pause()
            time.sleep(rng.uniform(0.0, 0.2))
            link.change(CUT)
            time.sleep(rng.uniform(0.5, 4.0))
            (display.resume if apart_s < 0 else lambda: link.change(WHOLE))()
            time.sleep(abs(apart_s))
            (display.resume if apart_s >= 0 else lambda: link.change(WHOLE))()
            return time.monotonic_ns()

        back_ms = again(finger, times, rng, cut)
        return Found(unaccounted(sensing.end(), display.account()), finger.peaks(), back_ms)


def one_of_two_networks_cut(folder: Path, times: int, rng: random.Random) -> Found:
    """Now the one and now the other, for 0.5 to 3 s."""
    with emulate(WHOLE, WHOLE) as link, staged(folder, link) as stage:
        sensing, display, finger = stage.play()
        began_ns = time.monotonic_ns()
        for number in range(times):
            link.change(CUT, number % 2)
            time.sleep(rng.uniform(0.5, 3.0))
            link.change(WHOLE, number % 2)
            # Until that one carries frames again: at worst it is connected anew.
            time.sleep(3.0)
        felt = finger.felt_share(began_ns, time.monotonic_ns())
        return Found(unaccounted(sensing.end(), display.account()), finger.peaks(), felt=felt)


def display_stopped(folder: Path, times: int, rng: random.Random) -> Found:
    """SIGSTOP of one display for 0.5 to 20 s; `felt` is at another one."""
    with staged(folder) as stage:
        sensing, display, finger = stage.play()
        other = stage.display("other")
        others_finger = stage.finger("other")
        began_ns = others_finger.felt_from_ns(other.listening_ns, BACK_WITHIN_S) or 0

        def stop() -> int:
            display.pause()
            time.sleep(rng.uniform(0.5, 20.0))
            display.resume()
            return time.monotonic_ns()

        back_ms = again(finger, times, rng, stop)
        felt = others_finger.felt_share(began_ns, time.monotonic_ns())
        sent = sensing.end()
        missing = unaccounted(sent, display.account()) + unaccounted(sent, other.account())
        return Found(missing, finger.peaks(), back_ms, felt)


def one_of_twenty_never_reads(folder: Path, times: int, rng: random.Random) -> Found:
    """Play a display beside eighteen listeners in one process and one that never reads."""
    with staged(folder) as stage:
        sensing, display, finger = stage.play()
        command = ("-m", "benchmarks.faults.many_displays", stage.connect[0], str(LISTENERS))
        crowd = stage.stack.enter_context(ChildProcess("crowd", *command, stdout=PIPE))
        crowd.read_line(STREAM_ENDS_WITHIN_S)
        time.sleep(1.0)
        began_ns = time.monotonic_ns()
        for _ in range(times):
            with deaf_subscriber(port_of(stage.connect[0])):
                time.sleep(WATCHED_S)
        felt = finger.felt_share(began_ns, time.monotonic_ns())
        sent, account = sensing.end(), display.account()
        output, _ = crowd.communicate(timeout=STREAM_ENDS_WITHIN_S)
        missing = unaccounted(sent, account) + missing_in_crowd(output, sent.samples.sent or 0)
        return Found(missing, finger.peaks(), felt=felt)


def missing_in_crowd(output: str, sent: int) -> int:
    """Return how many samples the accounts of the many displays do not name, or name as
    lost.
    """
    accounts = json.loads(output)
    return sum(abs(sent - total - before) + lost for total, _, _, lost, before in accounts)


def flooded(port: str) -> Callable[[Path, int, random.Random], Found]:
    """Garbage on the "data", "control" or "telemetry" port."""

    def case(folder: Path, times: int, rng: random.Random) -> Found:
        with staged(folder) as stage:
            (stage.telemetry_address,) = free_addresses(1)
            sensing, display, finger = stage.play()
            (data,) = stage.connect
            addresses = {"data": data, "control": control_address(data)}
            number = port_of(addresses.get(port, stage.telemetry_address))
            began_ns = time.monotonic_ns()
            with yielding():
                for _ in range(times):
                    with silent_connections(number, SILENT):
                        raw_garbage(number, RAW, rng)
                        for kind in (zmq.DEALER, zmq.XSUB, zmq.PUB):
                            garbage_messages(number, kind, MESSAGES, rng)
            felt = finger.felt_share(began_ns, time.monotonic_ns())
            return Found(unaccounted(sensing.end(), display.account()), finger.peaks(), felt=felt)

    return case


def suspended(whose: str) -> Callable[[Path, int, random.Random], Found]:
    """The "sensing" host or the "display"'s was suspended, and its clock with it."""

    def case(folder: Path, times: int, rng: random.Random) -> Found:
        with stepping(-SUSPENDED_S), staged(folder) as stage:
            sensing, display, finger = stage.play(stepped=True)
            node: Node = sensing if whose == "sensing" else display
            behind_ns = 0

            def suspend() -> int:
                nonlocal behind_ns
                node.pause()
                time.sleep(SUSPENDED_S)
                node.step_clock()
                node.resume()
                behind_ns += round(SUSPENDED_S * 1e9) if node is display else 0
                return time.monotonic_ns() - behind_ns

            back_ms = again(finger, times, rng, suspend)
            return Found(unaccounted(sensing.end(), display.account()), finger.peaks(), back_ms)

    return case


@contextmanager
def yielding() -> Iterator[None]:
    """Run without real-time priority within: the harm stands for another machine's, and must take
    no processor time from nodes that inherited such a priority from us.
    """
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, priority)


@contextmanager
def stepping(seconds: float) -> Iterator[None]:
    """Clocks that are started within step by so much."""
    os.environ[STEP_VARIABLE] = str(seconds)
    try:
        yield
    finally:
        del os.environ[STEP_VARIABLE]


CASES: dict[str, Callable[[Path, int, random.Random], Found]] = {
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
