"""Faults made on the nodes, and the times without the pulse: after each, and without one."""

import asyncio
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from soak.felt import FeltLog, felt_again_ns, longest_gap_ns
from soak.processes import SoakProcess
from soak.scenario import LINKS, Scenario
from soak.schedule import (
    CONTINUOUS,
    FLOOD_KINDS,
    FREEZES,
    LINK_KINDS,
    PORTS,
    RESTARTED,
    RESTARTS,
    SENSING,
    TEMPORARY,
    Fault,
)

ALWAYS_THERE = (CONTINUOUS, RESTARTED)


@dataclass(frozen=True, slots=True)
class Done:
    """A fault as it was made. displays: those that it affects.

    It ends when the normal state is restored: a node's loop runs again, the link is calm, or the
    flood has ended.
    """

    fault: Fault
    began_ns: int
    over_ns: int
    displays: tuple[str, ...]


async def do(fault: Fault, scenario: Scenario, seed: int) -> Done:
    """Make a fault, and return the time of its end."""
    await asyncio.sleep(fault.after_s)
    began_ns = time.perf_counter_ns()
    over_ns = await _do(fault, scenario, seed)
    return Done(fault, began_ns, over_ns, _displays(fault))


def _displays(fault: Fault) -> tuple[str, ...]:
    if fault.target in (SENSING, PORTS):
        return CONTINUOUS, RESTARTED
    return (fault.target,)


async def _do(fault: Fault, scenario: Scenario, seed: int) -> int:
    kind = fault.kind
    if kind in LINK_KINDS:
        return await _worsen(fault, scenario)
    if fault.target == PORTS:
        return await _flood(fault, scenario, seed)
    if kind == "temporary display":
        return await _visit(fault, scenario)
    node = scenario.nodes[fault.target]
    if kind in FREEZES:
        await node.freeze(fault.for_s)
        return time.perf_counter_ns()
    return await _replace(fault, node, scenario, seed)


async def _replace(fault: Fault, node: SoakProcess, scenario: Scenario, seed: int) -> int:
    """End a node, and start a successor."""
    if fault.kind in RESTARTS:
        await node.stop()
    else:
        node.kill()
    if fault.kind == "impostor":
        intruder = scenario.start_intruder("impostor", str(seed), scenario.network.bind)
        await asyncio.sleep(fault.for_s)
        scenario.stop_intruder(intruder)
    else:
        await asyncio.sleep(fault.for_s)
    return await scenario.start(fault.target).up()


async def _worsen(fault: Fault, scenario: Scenario) -> int:
    links = LINKS[fault.target]
    if fault.kind == "cut of one path":
        links = links[:1]
    for number in links:
        scenario.network.change(number, fault.detail)
    await asyncio.sleep(fault.for_s)
    for number in links:
        scenario.network.change(number)
    return time.perf_counter_ns()


async def _flood(fault: Fault, scenario: Scenario, seed: int) -> int:
    name = FLOOD_KINDS[fault.kind]
    addresses = [scenario.network.near]
    if name == "telemetry":
        addresses = [scenario.telemetry(role) for role in (CONTINUOUS, RESTARTED)]
    intruder = scenario.start_intruder(name, str(seed), *addresses)
    await asyncio.sleep(fault.for_s)
    scenario.stop_intruder(intruder)
    return time.perf_counter_ns()


async def _visit(fault: Fault, scenario: Scenario) -> int:
    """Start a display that leaves later; the fault ends when its loop runs."""
    node = scenario.start(TEMPORARY)
    up_ns = await node.up()
    await asyncio.sleep(fault.for_s)
    if fault.detail == "killed":
        node.kill()
    else:
        await node.stop()
    return up_ns


@dataclass(frozen=True, slots=True)
class Played:
    """An episode as it was made, with the rest after it."""

    done: tuple[Done, ...]
    began_ns: int
    until_ns: int

    def over_ns(self, role: str) -> int | None:
        """Return the end of the last fault of a display; None without one."""
        return max((done.over_ns for done in self.done if role in done.displays), default=None)

    def kind(self, role: str) -> str:
        """Return the kinds of the faults made on the display."""
        return " + ".join(sorted({x.fault.kind for x in self.done if role in x.displays}))


def recoveries(
    episodes: Sequence[Played], felt: Mapping[str, FeltLog]
) -> dict[str, list[float | None]]:
    """Return, by kind of fault, the times in s from its end until the pulse was felt again.

    None if it was not felt before the next fault.
    """
    table: dict[str, list[float | None]] = {}

    def add(kind: str, role: str, over_ns: int, until_ns: int) -> None:
        again_ns = felt_again_ns(felt[role].spells, over_ns, until_ns)
        table.setdefault(kind, []).append(None if again_ns is None else again_ns * 1e-9)

    for played in episodes:
        for role in ALWAYS_THERE:
            over_ns = played.over_ns(role)
            if over_ns is not None:
                add(played.kind(role), role, over_ns, played.until_ns)
        # With a second fault, a temporary display need not have felt anything before it left.
        if len(played.done) == 1 and played.done[0].fault.kind == "temporary display":
            (done,) = played.done
            add(
                "temporary display",
                TEMPORARY,
                done.over_ns,
                done.over_ns + round(done.fault.for_s * 1e9),
            )
    return table


def undisturbed_gaps_s(episodes: Sequence[Played], felt: Mapping[str, FeltLog]) -> list[float]:
    """Return the longest times in s without the pulse at displays that were not disturbed.

    There is one for each display and episode.
    """
    return [
        gap_s
        for role in ALWAYS_THERE
        for gap_s in gaps_s([x for x in episodes if x.over_ns(role) is None], felt[role])
    ]


def gaps_s(episodes: Sequence[Played], felt: FeltLog) -> list[float]:
    """Return the longest time without the pulse in each of these episodes."""
    return [longest_gap_ns(felt.spells, x.began_ns, x.until_ns) * 1e-9 for x in episodes]
