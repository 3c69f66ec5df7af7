"""One direction of a link: when does a packet arrive?

Bad spells that come and go: the two-state Markov chain of Gilbert and Elliott, in time.
"""

import math
from bisect import bisect_right
from random import Random

from telepulse.simulation.link_model.scene import LinkScene


class GilbertElliott:
    """Bad spells of exponential length, so that `share` of all time is bad.

    They depend on the seed and the time alone, not on what is sent: a link has the same weather
    for whoever uses it. Times may be asked for in any order.
    """

    def __init__(self, share: float, mean_ns: int, random: Random, start_ns: int) -> None:
        self._means_ns = (mean_ns * (1 - share) / share, mean_ns)
        self._random = random
        # Where good turns bad and bad turns good, by turns.
        self._edges_ns = [start_ns]
        self._extend()

    def end_ns(self, now_ns: int) -> int | None:
        """When the bad spell at `now_ns` ends; None outside of one."""
        while self._edges_ns[-1] <= now_ns:
            self._extend()
        position = bisect_right(self._edges_ns, now_ns)
        return self._edges_ns[position] if position % 2 == 0 and position else None

    def _extend(self) -> None:
        mean_ns = self._means_ns[(len(self._edges_ns) + 1) % 2]
        length_ns = max(1, round(self._random.expovariate(1 / mean_ns)))
        self._edges_ns.append(self._edges_ns[-1] + length_ns)


# Tail of the Pareto jitter: the share beyond x falls with its third power. The least whole number
# with a standard deviation, which `jitter` is.
PARETO_SHAPE = 3
# The link stands still for a tenth of the time when its jitter comes in bursts.
BURSTS_SHARE = 0.1
# A packet that would wait in the rate limit's queue for longer is lost.
QUEUE_NS = 200_000_000
_PARETO_DEVIATION = math.sqrt(PARETO_SHAPE / (PARETO_SHAPE - 2)) / (PARETO_SHAPE - 1)
# A packet meets a standstill with the probability above, and then waits exponentially long.
_BURSTS_DEVIATION = math.sqrt(2 * BURSTS_SHARE - BURSTS_SHARE**2)


class Direction:
    """One direction of a link; the same seed gives the same fate to the same packets.

    Packets are offered in the order of their sending. They are independent of each other but for
    the queue of the rate limit, and may overtake one another. start_ns: when the link began.
    """

    def __init__(self, scene: LinkScene, seed: int, start_ns: int = 0) -> None:
        self._scene = scene
        self._random = Random(seed)
        self._start_ns = start_ns
        self._idle_ns = start_ns
        self._outages = self._standstills = None
        if scene.burst_loss is not None:
            share, mean_ns = scene.burst_loss.share, scene.burst_loss.length_ns
            self._outages = GilbertElliott(share, mean_ns, Random(f"loss {seed}"), start_ns)
        if scene.jitter_ns and scene.jitter_kind == "bursts":
            mean_ns = max(1, round(scene.jitter_ns / _BURSTS_DEVIATION))
            self._standstills = GilbertElliott(
                BURSTS_SHARE, mean_ns, Random(f"jitter {seed}"), start_ns
            )
        self.lost = 0

    def arrival_ns(self, now_ns: int, size_bytes: int) -> int | None:
        """When a packet that is sent now arrives; None when it is lost."""
        if max(0, self._idle_ns - now_ns) > QUEUE_NS:
            self.lost += 1
            return None
        return self.fly(self.queue(now_ns, size_bytes))

    def queue(self, now_ns: int, size_bytes: int) -> int:
        """When a packet that is sent now has passed the rate limit."""
        rate_bit_per_s = self._scene.rate_bit_per_s
        if rate_bit_per_s is None:
            return now_ns
        begin_ns = max(now_ns, self._idle_ns)
        self._idle_ns = begin_ns + round(8e9 * size_bytes / rate_bit_per_s)
        return self._idle_ns

    def fly(self, at_ns: int) -> int | None:
        """When a packet that leaves the queue at `at_ns` arrives; None when it is lost."""
        unlucky = self._scene.loss > 0 and self._random.random() < self._scene.loss
        if unlucky or self.outage_until(at_ns) is not None:
            self.lost += 1
            return None
        return self.fly_surely(at_ns)

    def fly_surely(self, at_ns: int) -> int:
        """When a packet that leaves the queue at `at_ns` arrives, if nothing loses it."""
        arrival_ns = at_ns + max(0, self.base_ns(at_ns) + self._jitter_ns(at_ns))
        reorder = self._scene.reorder
        if reorder is not None and self._random.random() < reorder.share:
            arrival_ns += reorder.by_ns
        return arrival_ns

    def outage_until(self, at_ns: int) -> int | None:
        """When the cut or burst of loss that there is at `at_ns` ends; None while there is none."""
        cut_ns = self.cut_until(at_ns)
        burst_ns = None if self._outages is None else self._outages.end_ns(at_ns)
        return burst_ns if cut_ns is None else max(cut_ns, burst_ns or 0)

    def cut_until(self, at_ns: int) -> int | None:
        """When the cut that there is at `at_ns` ends; None while there is none."""
        cut = self._scene.cut
        if cut is None or not 0 <= at_ns - self._start_ns - cut.from_ns < cut.for_ns:
            return None
        return self._start_ns + cut.from_ns + cut.for_ns

    def base_ns(self, at_ns: int) -> int:
        """The delay without jitter."""
        change, delay_ns = self._scene.route_change, self._scene.delay_ns
        if change is not None and at_ns - self._start_ns >= change.at_ns:
            delay_ns = max(0, delay_ns + change.by_ns)
        return delay_ns

    def _jitter_ns(self, at_ns: int) -> int:
        jitter_ns = self._scene.jitter_ns
        if self._standstills is not None:
            end_ns = self._standstills.end_ns(at_ns)
            return 0 if end_ns is None else end_ns - at_ns
        if not jitter_ns:
            return 0
        if self._scene.jitter_kind == "pareto":
            beyond = self._random.paretovariate(PARETO_SHAPE) - 1
            return round(jitter_ns * beyond / _PARETO_DEVIATION)
        return round(self._random.gauss(0, jitter_ns))
