"""Lateness of ticks with each real-time setting and without, and the verdict on the host."""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field

import zmq

from display_node.doctor.host import Host, advice_on, stolen
from display_node.scoring.deadlines import ALARM_SHARE, GAP_NS
from protocol import sockets
from protocol.histogram import Histogram
from protocol.host.child_process import ChildProcess
from protocol.host.descriptors import DescriptorSet
from protocol.host.realtime import (
    Pacer,
    RealtimeGrant,
    RealtimeRequest,
    apply_realtime,
    parse_realtime,
)

# A busy process polls its parent's id, so it ends even where its parent is killed.
BUSY = """
import os, sys
while os.getppid() == int(sys.argv[1]):
    pass
"""
MAX_ROUNDS = 4
LEAST_SLOT_S = 0.1
BARE, TOGETHER = "bare", "together"
IDLE, LOADED = "nothing", "load"
# Largest share of missed ticks, under load and with all granted settings, that is "ok".
OK_MISSED = 1e-3
# A larger share of time taken by the hypervisor is reported.
STOLEN = 1e-2

Work = Callable[[int, int], object]
"""Work of a tick: takes the time in ns at which it was due, and the ticks since the last."""


@dataclass(slots=True)
class Ticks:
    """Lateness of ticks in µs, and number of ticks that did not begin in their period."""

    late_us: Histogram = field(default_factory=lambda: Histogram(2.0, 5_000))
    missed: int = 0

    @property
    def due(self) -> int:
        """Number of ticks that were due."""
        return self.late_us.count + self.missed


def run_ticks(
    ticks: Ticks, tick_ns: int, seconds: float, descriptors: DescriptorSet, work: Work
) -> None:
    """Wait for ticks as a display does, and call `work` in each."""
    pacer = Pacer(tick_ns, time.perf_counter_ns())
    end_ns = pacer.due_ns + round(seconds * 1e9)
    # A tick that was due before the end but begins after it counts: it may be the latest.
    while pacer.due_ns <= end_ns:
        now_ns = time.perf_counter_ns()
        tick = pacer.begin(now_ns)
        if tick is None:
            sockets.wait_on_descriptors(descriptors, pacer.due_ns - now_ns)
            continue
        ticks.late_us.add(tick.late_ns * 1e-3)
        work(tick.due_ns, tick.elapsed_ticks)
    ticks.missed += pacer.missed


@contextmanager
def busy_processes(count: int) -> Iterator[None]:
    """Run `count` processes that compute without a pause, within a `with`."""
    with ExitStack() as stack:
        for _ in range(count):
            stack.enter_context(ChildProcess("busy process", "-S", "-c", BUSY, str(os.getpid())))
        yield


@dataclass(frozen=True, slots=True)
class HostFindings:
    """Findings of a doctor's run.

    ticks: by setting and load. option: the value to pass to --realtime, None where nothing is
    granted. stolen: share of the time that a hypervisor took away.
    """

    tick_ns: int
    ticks: Mapping[tuple[str, str], Ticks]
    option: str | None
    refusals: Sequence[str]
    stolen: float


def measure(
    tick_ns: int, work: Work, held: RealtimeGrant, seconds: float, processors: int, isolated: str
) -> HostFindings:
    """Measure ticks bare, with each granted setting, and with all of them.

    The cases take turns, so that a change of the host's load affects all of them. The combination
    pins the loop only to an isolated processor: pinning to another one does not help.
    """
    granted = {name: parse_realtime(name) for name in held.granted}
    chosen = [name for name, request in granted.items() if isolated or not request.cpus]
    wanted = {BARE: RealtimeRequest()} | granted
    if chosen:
        wanted[TOGETHER] = parse_realtime(",".join(chosen))
    each_s = seconds / (2 * len(wanted))
    rounds = min(max(round(each_s / LEAST_SLOT_S), 1), MAX_ROUNDS)
    ticks = {(name, beside): Ticks() for beside in (IDLE, LOADED) for name in wanted}
    context: sockets.Context = zmq.Context()
    with ExitStack() as stack:
        stack.callback(context.destroy, linger=0)
        silent = sockets.unconnected(context, zmq.SUB)
        descriptors = sockets.descriptors([silent])
        stolen_before, all_before = stolen()
        for beside, busy in ((LOADED, processors), (IDLE, 0)):
            with busy_processes(busy):
                for name, request in list(wanted.items()) * rounds:
                    with apply_realtime(request):
                        slot = ticks[name, beside]
                        run_ticks(slot, tick_ns, each_s / rounds, descriptors, work)
        stolen_after, all_after = stolen()
    taken = (stolen_after - stolen_before) / max(1, all_after - all_before)
    refusals = [str(refusal) for refusal in held.refused]
    return HostFindings(tick_ns, ticks, ",".join(chosen) or None, refusals, taken)


@dataclass(frozen=True, slots=True)
class HostVerdict:
    """Verdict ok, warn or fail; its reason in a line; lines of advice, most effective first."""

    status: str
    reason: str
    advice: list[str]


def judge(host: Host, findings: HostFindings) -> HostVerdict:
    """Judge whether this host keeps a loop on time; add advice."""
    bare = findings.ticks[BARE, LOADED]
    best = findings.ticks.get((TOGETHER, LOADED), bare)
    share = best.missed / best.due if best.due else 1.0
    latest_ms = (best.late_us.maximum or 0.0) * 1e-3
    status = "ok" if share <= OK_MISSED else "warn" if share <= ALARM_SHARE else "fail"
    how = f"with --realtime {findings.option}" if best is not bare else "without --realtime"
    reason = f"beside a load, {how}, {best.missed} of {best.due} ticks were missed"
    if best is not bare:
        reason += f" (bare {bare.missed} of {bare.due})"
    reason += f", the latest began {latest_ms:.1f} ms late"
    if latest_ms * 1e6 > GAP_NS:
        status = "fail"
        reason += f": longer than the watchdog of a drive ({GAP_NS * 1e-6:.0f} ms)"
    advice = []
    if findings.stolen > STOLEN:
        advice.append(
            f"the hypervisor gave {findings.stolen:.1%} of the time to others: nothing set here"
            " helps against that; take a machine of its own, or pin its processors"
        )
    advice += [*advice_on(host), *findings.refusals]
    return HostVerdict(status, reason, advice)
