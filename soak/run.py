"""A soak as it runs: episodes one after the other, and all that is needed to judge them."""

import asyncio
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from soak.faults import do
from soak.leftovers import namespaces_of
from soak.recovery import Played, recoveries
from soak.scenario import CALM_DISPLAY, CALM_SENSING, TORMENTED, Scenario
from soak.schedule import ENDURING, MORTAL, SENSING, Episode, episodes
from soak.taps import Taps
from soak.terminals import Terminals

SAMPLE_EVERY_S = 2.0
# All nodes up and felt, before the first fault.
HEAD_START_S = 4.0
ENDED_WITHIN_S = 6.0
MINUTE_S = 60.0


@dataclass(slots=True)
class Run:
    """One soak. log: where a line a minute goes. namespaces: those its nodes were in."""

    stage: Scenario
    seed: int
    seconds: float
    tick_ns: int
    log: Callable[[str], None]
    taps: Taps = field(default_factory=Taps)
    terminals: Terminals = field(default_factory=Terminals)
    played: list[Played] = field(default_factory=list)
    namespaces: set[int] = field(default_factory=set)
    began_ns: int = field(default_factory=time.monotonic_ns)

    async def play(self) -> None:
        """Start all nodes, torment them until the time is over, and end them."""
        stage, taps = self.stage, self.taps
        keys = stage.keys.monitor if stage.keys else None
        taps.follow_sensing(SENSING, stage.network.near, stage.network.sensing, keys)
        taps.follow_sensing(CALM_SENSING, stage.calm_address, None, keys)
        for role in (*TORMENTED, CALM_DISPLAY):
            taps.follow_display(role, stage.telemetry(role), stage.lives, self.tick_ns)
        watchers = [asyncio.create_task(self._measure()), asyncio.create_task(self._tell())]
        try:
            for role in (SENSING, CALM_SENSING, ENDURING, MORTAL, CALM_DISPLAY):
                stage.start(role)
            await asyncio.gather(*(life.up() for life in stage.lives.values()))
            for role in (CALM_DISPLAY, ENDURING, MORTAL):
                self.terminals.open(role, stage.telemetry(role))
            stage.refuse_dead()
            self.namespaces = namespaces_of([x.process.pid for x in stage.lives.values()])
            await asyncio.sleep(HEAD_START_S)
            await self._torment()
            await self._end()
        finally:
            for watcher in watchers:
                watcher.cancel()
            await self.terminals.close()
            await taps.close()

    async def _torment(self) -> None:
        until_ns = self.began_ns + round(self.seconds * 1e9)
        for number, episode in enumerate(episodes(self.seed)):
            if time.monotonic_ns() + round(_length_s(episode) * 1e9) > until_ns:
                return
            began_ns = time.monotonic_ns()
            seed = self.seed + number
            done = await asyncio.gather(*(do(fault, self.stage, seed) for fault in episode.faults))
            await asyncio.sleep(episode.rest_s)
            self.played.append(Played(tuple(done), began_ns, time.monotonic_ns()))

    async def _end(self) -> None:
        """The pulse ends, and every display is told; then the displays."""
        lives = self.stage.lives
        sensing = [lives[SENSING], lives[CALM_SENSING]]
        displays = [lives[ENDURING], lives[MORTAL], lives[CALM_DISPLAY]]
        await asyncio.gather(*(life.stop() for life in sensing))
        until_ns = time.monotonic_ns() + round(ENDED_WITHIN_S * 1e9)
        while time.monotonic_ns() < until_ns:
            if all(life.marks and life.marks[-1].state == "ended" for life in displays):
                break
            await asyncio.sleep(0.1)
        # The last samples' instants, and a status that knows of them.
        await asyncio.sleep(1.0)
        await asyncio.gather(*(life.stop() for life in displays))
        await asyncio.sleep(0.2)

    async def _measure(self) -> None:
        while True:
            for life in self.stage.lives.values():
                life.measure()
            await asyncio.sleep(SAMPLE_EVERY_S)

    async def _tell(self) -> None:
        minutes = 0
        while True:
            await asyncio.sleep(MINUTE_S)
            minutes += 1
            self.log(self._line(minutes))

    def _line(self, minutes: int) -> str:
        """How it stands: one line."""
        faults = Counter(done.fault.kind for played in self.played for done in played.done)
        table = recoveries(self.played, self.taps.felt)
        again_s = [after_s for all_s in table.values() for after_s in all_s]
        worst_s = max((after_s for after_s in again_s if after_s is not None), default=0.0)
        never = again_s.count(None)
        memory = ", ".join(
            f"{role} {life.usage[-1].memory_bytes / 1e6:.1f}"
            for role, life in self.stage.lives.items()
            if life.running and life.usage
        )
        return (
            f"minute {minutes} of {self.seconds / MINUTE_S:g}: {sum(faults.values())} faults of"
            f" {len(faults)} kinds, felt again within {worst_s:.2f} s, {never} times not; memory in"
            f" MB: {memory}"
        )


def _length_s(episode: Episode) -> float:
    """How long an episode takes, about: a node that starts takes a second or two."""
    return max(fault.after_s + fault.for_s for fault in episode.faults) + episode.rest_s + 2.0
