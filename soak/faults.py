"""Make the faults of a schedule on the nodes, and return when each has ended."""

import asyncio
import time
from dataclasses import dataclass

from soak.processes import SoakProcess
from soak.scenario import LINKS, Scenario
from soak.schedule import CONTINUOUS, PORTS, RESTARTED, SENSING, TEMPORARY, Fault


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
    return (fault.target.removesuffix("'s link"),)


async def _do(fault: Fault, scenario: Scenario, seed: int) -> int:
    kind = fault.kind
    if fault.target.endswith("'s link"):
        return await _worsen(fault, scenario)
    if fault.target == PORTS:
        return await _flood(fault, scenario, seed)
    if kind == "temporary display":
        return await _visit(fault, scenario)
    node = scenario.nodes[fault.target]
    if kind.startswith("freeze"):
        await node.freeze(fault.for_s)
        return time.perf_counter_ns()
    return await _replace(fault, node, scenario, seed)


async def _replace(fault: Fault, node: SoakProcess, scenario: Scenario, seed: int) -> int:
    """End a node, and start a successor."""
    if fault.kind.startswith("restart"):
        await node.stop()
    else:
        node.kill()
    if fault.kind == "impostor":
        intruder = scenario.start_intruder("impostor", scenario.network.bind, str(seed))
        await asyncio.sleep(fault.for_s)
        scenario.stop_intruder(intruder)
    else:
        await asyncio.sleep(fault.for_s)
    return await scenario.start(fault.target).up()


async def _worsen(fault: Fault, scenario: Scenario) -> int:
    links = LINKS[fault.target.removesuffix("'s link")]
    if fault.kind == "cut of one path":
        links = links[:1]
    for number in links:
        scenario.network.change(number, fault.detail)
    await asyncio.sleep(fault.for_s)
    for number in links:
        scenario.network.change(number)
    return time.perf_counter_ns()


async def _flood(fault: Fault, scenario: Scenario, seed: int) -> int:
    name = fault.kind.removeprefix("flood of ")
    addresses = [scenario.network.near]
    if name == "telemetry":
        addresses = [scenario.telemetry(role) for role in (CONTINUOUS, RESTARTED)]
    intruder = scenario.start_intruder("floods", name, str(seed), *addresses)
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
