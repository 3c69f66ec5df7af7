"""How each kind of fault is done to the nodes, and when it is over."""

import asyncio
import time
from dataclasses import dataclass

from soak.processes import SoakProcess
from soak.scenario import LINKS, Scenario
from soak.schedule import ENDURING, GUEST, MORTAL, PORTS, SENSING, Fault


@dataclass(frozen=True, slots=True)
class Done:
    """A fault as it was: when it began, when it was over, whom it was done to.

    Over is when all is as before: a node's loop runs again, the link is calm, the flood ended.
    """

    fault: Fault
    began_ns: int
    over_ns: int
    displays: tuple[str, ...]


async def do(fault: Fault, stage: Scenario, seed: int) -> Done:
    """Do a fault; returns when it is over."""
    await asyncio.sleep(fault.after_s)
    began_ns = time.monotonic_ns()
    over_ns = await _do(fault, stage, seed)
    return Done(fault, began_ns, over_ns, _displays(fault))


def _displays(fault: Fault) -> tuple[str, ...]:
    if fault.target in (SENSING, PORTS):
        return ENDURING, MORTAL
    return (fault.target.removesuffix("'s link"),)


async def _do(fault: Fault, stage: Scenario, seed: int) -> int:
    kind = fault.kind
    if fault.target.endswith("'s link"):
        return await _worsen(fault, stage)
    if fault.target == PORTS:
        return await _flood(fault, stage, seed)
    if kind == "guest":
        return await _visit(fault, stage)
    life = stage.lives[fault.target]
    if kind.startswith("freeze"):
        await life.freeze(fault.for_s)
        return time.monotonic_ns()
    return await _replace(fault, life, stage, seed)


async def _replace(fault: Fault, life: SoakProcess, stage: Scenario, seed: int) -> int:
    """A node ends, and another one takes its place."""
    if fault.kind.startswith("restart"):
        await life.stop()
    else:
        life.kill()
    if fault.kind == "impostor":
        pest = stage.pester("impostor", stage.network.bind, str(seed))
        await asyncio.sleep(fault.for_s)
        stage.relieve(pest)
    else:
        await asyncio.sleep(fault.for_s)
    return await stage.start(fault.target).up()


async def _worsen(fault: Fault, stage: Scenario) -> int:
    links = LINKS[fault.target.removesuffix("'s link")]
    if fault.kind == "cut of one path":
        links = links[:1]
    for number in links:
        stage.network.change(number, fault.detail)
    await asyncio.sleep(fault.for_s)
    for number in links:
        stage.network.change(number)
    return time.monotonic_ns()


async def _flood(fault: Fault, stage: Scenario, seed: int) -> int:
    name = fault.kind.removeprefix("flood of ")
    addresses = [stage.network.near]
    if name == "telemetry":
        addresses = [stage.telemetry(role) for role in (ENDURING, MORTAL)]
    pest = stage.pester("floods", name, str(seed), *addresses)
    await asyncio.sleep(fault.for_s)
    stage.relieve(pest)
    return time.monotonic_ns()


async def _visit(fault: Fault, stage: Scenario) -> int:
    """A display joins and leaves. It is no fault to it: over is when it may begin to feel."""
    life = stage.start(GUEST)
    up_ns = await life.up()
    await asyncio.sleep(fault.for_s)
    if fault.detail == "killed":
        life.kill()
    else:
        await life.stop()
    return up_ns
