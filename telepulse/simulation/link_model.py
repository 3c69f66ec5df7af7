"""Model of a network link: the time at which each packet or message arrives, or its loss. Pure.

It is used for messages in virtual time, for those of a proxy between two nodes, and for the IP
packets of the emulated link.
"""

import math
from bisect import bisect_right
from random import Random
from typing import Final

from telepulse.simulation.link_scene import LinkScene, Wander

# Tail of the Pareto jitter: P(X > x) ∝ x⁻³. 3 is the smallest integer exponent with a finite
# standard deviation, which `jitter` gives.
PARETO_SHAPE: Final = 3
_PARETO_DEVIATION = math.sqrt(PARETO_SHAPE / (PARETO_SHAPE - 2)) / (PARETO_SHAPE - 1)
# With jitter in bursts the link stalls for a tenth of the time. A packet meets a stall with that
# probability, and then waits for an exponential time.
STALLED_SHARE: Final = 0.1
_STALL_DEVIATION = math.sqrt(2 * STALLED_SHARE - STALLED_SHARE**2)
# A packet that would wait for longer in the queue of the rate limit is lost.
QUEUE_NS: Final = 200_000_000
# Linux: smallest retransmission timeout minus the round trip, and largest timeout.
RTO_MARGIN_NS: Final = 200_000_000
MAX_RTO_NS: Final = 120_000_000_000
# Share of the round trip that Linux waits for packets that may only be out of order (RACK).
REORDERING_WINDOW: Final = 0.25
# Headers that ZeroMQ, TCP and IP add to a short message: 2, 32 and 20 bytes.
HEADER_BYTES: Final = 54


class GilbertElliott:
    """Bad periods of exponential length: the two-state Markov chain of Gilbert and Elliott.

    The periods depend on the seed and the time alone, not on the traffic. Times may be queried
    in any order.

    share: share of all time that is bad, in (0, 1). mean_ns: mean length of a bad period.
    """

    def __init__(self, share: float, mean_ns: int, random: Random, start_ns: int) -> None:
        self._means_ns = (mean_ns * (1 - share) / share, mean_ns)
        self._random = random
        # Times at which good turns bad and bad turns good, alternately.
        self._edges_ns = [start_ns]
        self._extend()

    def end_ns(self, now_ns: int) -> int | None:
        """Return the end of the bad period at `now_ns`; None outside of one."""
        while self._edges_ns[-1] <= now_ns:
            self._extend()
        position = bisect_right(self._edges_ns, now_ns)
        return self._edges_ns[position] if position % 2 == 0 and position else None

    def _extend(self) -> None:
        mean_ns = self._means_ns[(len(self._edges_ns) + 1) % 2]
        length_ns = max(1, round(self._random.expovariate(1 / mean_ns)))
        self._edges_ns.append(self._edges_ns[-1] + length_ns)


class WanderingDelay:
    """A delay of 0 to `by`, linear between random values that are `over` apart.

    It depends on the seed and the time alone, not on the traffic. Times may be queried in any
    order.
    """

    def __init__(self, wander: Wander, random: Random, start_ns: int) -> None:
        self._wander, self._random, self._start_ns = wander, random, start_ns
        self._values_ns = [0]

    def at(self, now_ns: int) -> int:
        """Return the delay in ns at a time."""
        wander, values_ns = self._wander, self._values_ns
        number, into_ns = divmod(max(now_ns - self._start_ns, 0), wander.over_ns)
        while len(values_ns) < number + 2:
            values_ns.append(round(self._random.uniform(0, wander.by_ns)))
        before_ns, after_ns = values_ns[number : number + 2]
        return before_ns + (after_ns - before_ns) * into_ns // wander.over_ns


class Direction:
    """One direction of a link; with the same seed the same packets have the same fate.

    Packets are offered in the order of their sending, and may overtake one another. Random loss,
    jitter and reordering are drawn for each packet; packets close in time share the queue of the
    rate limit, bursts of loss and stalls.

    start_ns: time at which the link begins.
    """

    def __init__(self, scene: LinkScene, seed: int, start_ns: int = 0) -> None:
        self._scene, self._random = scene, Random(seed)
        self._start_ns = self._idle_ns = start_ns
        self._bursts = self._stalls = None
        if scene.burst_loss is not None:
            share, mean_ns = scene.burst_loss.share, scene.burst_loss.length_ns
            self._bursts = GilbertElliott(share, mean_ns, Random(f"loss {seed}"), start_ns)
        if scene.jitter_ns and scene.jitter_kind == "bursts":
            mean_ns = max(1, round(scene.jitter_ns / _STALL_DEVIATION))
            random = Random(f"jitter {seed}")
            self._stalls = GilbertElliott(STALLED_SHARE, mean_ns, random, start_ns)
        self._wander = None
        if scene.wander is not None:
            self._wander = WanderingDelay(scene.wander, Random(f"wander {seed}"), start_ns)
        self.lost = 0

    def arrival_ns(self, now_ns: int, size_bytes: int) -> int | None:
        """Return the arrival of a packet sent now; None when it is lost."""
        if self._idle_ns - now_ns > QUEUE_NS:
            self.lost += 1
            return None
        return self.propagate(self.queue(now_ns, size_bytes))

    def queue(self, now_ns: int, size_bytes: int) -> int:
        """Return the time at which a packet sent now has passed the rate limit."""
        rate_bit_per_s = self._scene.rate_bit_per_s
        if rate_bit_per_s is None:
            return now_ns
        begin_ns = max(now_ns, self._idle_ns)
        self._idle_ns = begin_ns + round(8e9 * size_bytes / rate_bit_per_s)
        return self._idle_ns

    def propagate(self, at_ns: int) -> int | None:
        """Return the arrival of a packet that leaves the queue at `at_ns`; None if it is lost."""
        dropped = self._scene.loss > 0 and self._random.random() < self._scene.loss
        if dropped or self.outage_end_ns(at_ns) is not None:
            self.lost += 1
            return None
        return self.propagate_reliably(at_ns)

    def propagate_reliably(self, at_ns: int) -> int:
        """Return the arrival of a packet that leaves the queue at `at_ns` and cannot be lost."""
        at_ns += self._stalled_ns(at_ns)
        arrival_ns = at_ns + max(0, self.base_ns(at_ns) + self._jitter_ns(at_ns))
        reorder = self._scene.reorder
        if reorder is not None and self._random.random() < reorder.share:
            arrival_ns += reorder.by_ns
        return arrival_ns

    def outage_end_ns(self, at_ns: int) -> int | None:
        """Return the end of the cut or burst of loss at `at_ns`; None outside of any."""
        cut_ns = self.cut_end_ns(at_ns)
        burst_ns = None if self._bursts is None else self._bursts.end_ns(at_ns)
        return burst_ns if cut_ns is None else max(cut_ns, burst_ns or 0)

    def cut_end_ns(self, at_ns: int) -> int | None:
        """Return the end of the cut at `at_ns`; None outside of it."""
        cut = self._scene.cut
        if cut is None or not 0 <= at_ns - self._start_ns - cut.from_ns < cut.for_ns:
            return None
        return self._start_ns + cut.from_ns + cut.for_ns

    def base_ns(self, at_ns: int) -> int:
        """Return the delay without jitter and stalls."""
        change, delay_ns = self._scene.route_change, self._scene.delay_ns
        if change is not None and at_ns - self._start_ns >= change.at_ns:
            delay_ns = max(0, delay_ns + change.by_ns)
        return delay_ns if self._wander is None else delay_ns + self._wander.at(at_ns)

    def _stalled_ns(self, at_ns: int) -> int:
        """Return the time until the end of a regular stall; 0 outside of one."""
        stall = self._scene.stall
        if stall is None:
            return 0
        ahead_ns = stall.every_ns - (at_ns - self._start_ns) % stall.every_ns
        return ahead_ns if ahead_ns <= stall.for_ns else 0

    def _jitter_ns(self, at_ns: int) -> int:
        jitter_ns = self._scene.jitter_ns
        if self._stalls is not None:
            end_ns = self._stalls.end_ns(at_ns)
            return 0 if end_ns is None else end_ns - at_ns
        if not jitter_ns:
            return 0
        if self._scene.jitter_kind == "pareto":
            beyond = self._random.paretovariate(PARETO_SHAPE) - 1
            return round(jitter_ns * beyond / _PARETO_DEVIATION)
        return round(self._random.gauss(0, jitter_ns))


class TcpStream:
    """A TCP connection over one direction of a link, with one packet for each message.

    No message is lost and none overtakes another: every message after a lost one waits for it. A
    lost packet is retransmitted at the earlier of two times (RFC 8985 and RFC 6298):

    - when the acknowledgement of the next packet reveals the loss. This is one time between
      messages, one round trip and a reordering window after the packet was sent (RACK).
    - at the retransmission timeout, which then doubles.

    The same holds for a lost retransmission. Once a retransmission by timeout has arrived, packets
    that were lost before it are sent again one round trip later.

    The time to the next message is assumed to be the time since the last one, and the round trip
    twice the link's delay. Not modelled: lost acknowledgements, congestion window, slow start,
    pacing, bandwidth used by retransmissions, an aborted connection.
    """

    def __init__(self, direction: Direction) -> None:
        self._direction = direction
        self._last_sent_ns: int | None = None
        self._last_arrival_ns = 0
        # Times at which the last packet sent by timeout left, and was acknowledged.
        self._repaired_ns = self._resumed_ns = 0

    def arrival_ns(self, now_ns: int, size_bytes: int) -> int:
        """Return the time at which a message sent now can be read at the other end."""
        sent_ns = self._direction.queue(now_ns, size_bytes)
        arrival_ns = self._direction.propagate(sent_ns)
        if arrival_ns is None:
            arrival_ns = self._retransmit(sent_ns)
        self._last_sent_ns = sent_ns
        self._last_arrival_ns = max(self._last_arrival_ns, arrival_ns)
        return self._last_arrival_ns

    def _retransmit(self, lost_ns: int) -> int:
        """Return the arrival of a message whose packet sent at `lost_ns` was lost."""
        direction, arrival_ns = self._direction, None
        round_trip_ns = 2 * direction.base_ns(lost_ns)
        rto_ns = round_trip_ns + RTO_MARGIN_NS
        # Time until the acknowledgement of the next message reveals the loss.
        gap_ns = MAX_RTO_NS if self._last_sent_ns is None else lost_ns - self._last_sent_ns
        detected_after_ns = gap_ns + round(round_trip_ns * (1 + REORDERING_WINDOW))
        if lost_ns < self._repaired_ns:
            lost_ns = self._resumed_ns
            arrival_ns = direction.propagate(lost_ns)
        while arrival_ns is None:
            alive_ns = direction.outage_end_ns(lost_ns) or lost_ns
            timeout_ns = lost_ns + rto_ns
            lost_ns = min(alive_ns + detected_after_ns, timeout_ns)
            arrival_ns = direction.propagate(lost_ns)
            if lost_ns == timeout_ns:
                rto_ns = min(2 * rto_ns, MAX_RTO_NS)
                if arrival_ns is not None:
                    self._repaired_ns, self._resumed_ns = lost_ns, lost_ns + round_trip_ns
        return arrival_ns


class MessageLink:
    """Data and control messages in one direction of a link, one packet for each message.

    As datagrams, data may be lost or reordered, and so may a set-point and the probe's answer to
    it, which the next ones replace; other control waits for the end of a cut and is never lost. As
    tcp, control has a connection, and data has one for each path.
    """

    def __init__(self, scene: LinkScene, seed: int, start_ns: int = 0) -> None:
        self._direction = Direction(scene, seed, start_ns)
        self._tcp = scene.transport == "tcp"
        self._data, self._control = [TcpStream(self._direction)], TcpStream(self._direction)
        self.lost_data = 0

    def data_arrival_ns(self, now_ns: int, size_bytes: int, path: int = 0) -> int | None:
        """Return the arrival of a data message sent now over a path; None when it is lost."""
        size_bytes += HEADER_BYTES
        if self._tcp:
            while path >= len(self._data):
                self._data.append(TcpStream(self._direction))
            return self._data[path].arrival_ns(now_ns, size_bytes)
        arrival_ns = self._direction.arrival_ns(now_ns, size_bytes)
        self.lost_data += arrival_ns is None
        return arrival_ns

    def control_arrival_ns(self, now_ns: int, size_bytes: int) -> int:
        """Return the arrival of a control message sent now."""
        size_bytes += HEADER_BYTES
        if self._tcp:
            return self._control.arrival_ns(now_ns, size_bytes)
        direction = self._direction
        passed_ns = direction.queue(now_ns, size_bytes)
        return direction.propagate_reliably(direction.cut_end_ns(passed_ns) or passed_ns)

    def press_arrival_ns(self, now_ns: int, size_bytes: int) -> int | None:
        """Return the arrival of a set-point, or of the answer to one; None when it is lost."""
        if self._tcp:
            return self.control_arrival_ns(now_ns, size_bytes)
        return self._direction.arrival_ns(now_ns, size_bytes + HEADER_BYTES)
