"""Run the episodes of a soak, and record them."""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from soak.faults import Played, do, recoveries
from soak.leftovers import namespaces_of
from soak.scenario import CALM_DISPLAY, CALM_SENSING, DISTURBED, Scenario
from soak.schedule import CONTINUOUS, RESTARTED, SENSING, Episode, episodes
from soak.taps import Taps, Terminals

SAMPLE_EVERY_S = 2.0
# Time in which all nodes start, and the pulse is felt at all displays, before the first fault.
HEAD_START_S = 4.0
ENDED_WITHIN_S = 6.0
MINUTE_S = 60.0


@dataclass(slots=True)
class Run:
    """A soak. log: function that receives one line per minute. namespaces: those of its nodes."""

    scenario: Scenario
    seed: int
    seconds: float
    tick_ns: int
    log: Callable[[str], None]
    taps: Taps = field(default_factory=Taps)
    terminals: Terminals = field(default_factory=Terminals)
    played: list[Played] = field(default_factory=list)
    namespaces: set[int] = field(default_factory=set)
    began_ns: int = field(default_factory=time.perf_counter_ns)

    async def play(self) -> None:
        """Start all nodes, make faults until the time is over, and end them."""
        scenario, taps = self.scenario, self.taps
        keys = scenario.keys.client("monitor") if scenario.keys else None
        taps.follow_sensing(SENSING, scenario.network.near, scenario.network.sensing, keys)
        taps.follow_sensing(CALM_SENSING, scenario.calm_address, None, keys)
        for role in (*DISTURBED, CALM_DISPLAY):
            taps.follow_display(role, scenario.telemetry(role), scenario.nodes, self.tick_ns)
        watchers = [asyncio.create_task(self._measure()), asyncio.create_task(self._log_progress())]
        try:
            for role in (SENSING, CALM_SENSING, CONTINUOUS, RESTARTED, CALM_DISPLAY):
                scenario.start(role)
            await asyncio.gather(*(node.up() for node in scenario.nodes.values()))
            for role in (CALM_DISPLAY, CONTINUOUS, RESTARTED):
                self.terminals.open(role, scenario.telemetry(role))
            scenario.refuse_dead()
            self.namespaces = namespaces_of([x.process.pid for x in scenario.nodes.values()])
            await asyncio.sleep(HEAD_START_S)
            await self._make_faults()
            await self._end()
        finally:
            for watcher in watchers:
                watcher.cancel()
            await self.terminals.close()
            await taps.close()

    async def _make_faults(self) -> None:
        until_ns = self.began_ns + round(self.seconds * 1e9)
        for number, episode in enumerate(episodes(self.seed)):
            if time.perf_counter_ns() + round(_length_s(episode) * 1e9) > until_ns:
                return
            began_ns = time.perf_counter_ns()
            seed = self.seed + number
            done = await asyncio.gather(
                *(do(fault, self.scenario, seed) for fault in episode.faults)
            )
            await asyncio.sleep(episode.rest_s)
            self.played.append(Played(tuple(done), began_ns, time.perf_counter_ns()))

    async def _end(self) -> None:
        """End the sensing nodes, whose end reaches every display, then the displays."""
        nodes = self.scenario.nodes
        sensing = [nodes[SENSING], nodes[CALM_SENSING]]
        displays = [nodes[CONTINUOUS], nodes[RESTARTED], nodes[CALM_DISPLAY]]
        await asyncio.gather(*(node.stop() for node in sensing))
        until_ns = time.perf_counter_ns() + round(ENDED_WITHIN_S * 1e9)
        while time.perf_counter_ns() < until_ns:
            if all(node.marks and node.marks[-1].state == "ended" for node in displays):
                break
            await asyncio.sleep(0.1)
        # The last samples are played, and a status reports them, in this time.
        await asyncio.sleep(1.0)
        await asyncio.gather(*(node.stop() for node in displays))
        await asyncio.sleep(0.2)

    async def _measure(self) -> None:
        while True:
            for node in self.scenario.nodes.values():
                node.measure()
            await asyncio.sleep(SAMPLE_EVERY_S)

    async def _log_progress(self) -> None:
        minutes = 0
        while True:
            await asyncio.sleep(MINUTE_S)
            minutes += 1
            self.log(self._line(minutes))

    def _line(self, minutes: int) -> str:
        """Return the state in one line."""
        faults = Counter(done.fault.kind for played in self.played for done in played.done)
        table = recoveries(self.played, self.taps.felt)
        again_s = [after_s for all_s in table.values() for after_s in all_s]
        worst_s = max((after_s for after_s in again_s if after_s is not None), default=0.0)
        never = again_s.count(None)
        memory = ", ".join(
            f"{role} {node.usage[-1].memory_bytes / 1e6:.1f}"
            for role, node in self.scenario.nodes.items()
            if node.running and node.usage
        )
        return (
            f"minute {minutes} of {self.seconds / MINUTE_S:g}: {sum(faults.values())} faults of"
            f" {len(faults)} kinds, felt again within {worst_s:.2f} s, {never} times not; memory in"
            f" MB: {memory}"
        )


def _length_s(episode: Episode) -> float:
    """Return the approximate length of an episode; a node takes a second or two to start."""
    return max(fault.after_s + fault.for_s for fault in episode.faults) + episode.rest_s + 2.0
