"""One direction of a link: when does a packet arrive?

Bad spells that come and go: the two-state Markov chain of Gilbert and Elliott, in time.

Whole messages over one direction of a link, as datagrams or as TCP streams.

Messages over one TCP connection: none is lost, none overtakes another, some come late.

The [link] section of a scene, in the file and on the command line.

A model of a network link, pure: it says when a packet or a message arrives, or that it is lost.

The same model carries the simulation's messages in virtual time, a relay's between two nodes, and
real IP packets in the emulator.
"""

import math
from bisect import bisect_right
from collections.abc import Iterator
from random import Random
from typing import Annotated, Any, Literal, Self

from pydantic import Field, model_validator

from protocol.config.quantities import BitsPerSecond, Nanoseconds, Ratio
from protocol.config.scene import Section, validate
from protocol.errors import SceneError

Duration = Annotated[Nanoseconds, Field(ge=0, le=10_000_000_000)]
SpellLength = Annotated[Nanoseconds, Field(gt=0, le=10_000_000_000)]
LinkTime = Annotated[Nanoseconds, Field(ge=0, le=86_400_000_000_000)]
Share = Annotated[Ratio, Field(gt=0, lt=1)]


class BurstLoss(Section):
    """Loss in bursts (Gilbert-Elliott): for `share` of the time, and `length` on average each
    time, nothing comes through."""

    share: Share
    length_ns: SpellLength


class Reorder(Section):
    """`share` of the packets take a way that is longer by `by`: later ones overtake them."""

    share: Share
    by_ns: SpellLength


class RouteChange(Section):
    """At `at` of the link's time, the delay grows by `by`."""

    at_ns: LinkTime
    by_ns: Annotated[Nanoseconds, Field(ge=-10_000_000_000, le=10_000_000_000)]


class Cut(Section):
    """At `from` of the link's time, nothing comes through `for` so long."""

    from_ns: LinkTime
    for_ns: LinkTime


class LinkScene(Section):
    """What a link does to what is sent over it.

    jitter: standard deviation of the delay, whatever its kind; a delay is never below 0.
    "gaussian" goes both ways, "pareto" (a heavy tail) and "bursts" (the link stands still, then
    all comes at once) only make later. loss: share of packets that vanish at random. rate: what
    the link can carry; what would wait in its queue for too long is lost. Times count from when
    the link begins, in the simulation half a second before the stream. transport: what messages
    are in a simulation, "datagram"s that are lost and overtake one another, or a "tcp" stream.
    """

    delay_ns: Duration = 0
    jitter_ns: Duration = 0
    jitter_kind: Literal["gaussian", "pareto", "bursts"] = "gaussian"
    loss: Annotated[Ratio, Field(ge=0, le=1)] = 0.0
    burst_loss: BurstLoss | None = None
    reorder: Reorder | None = None
    rate_bit_per_s: Annotated[BitsPerSecond | None, Field(ge=1e3, le=1e10)] = None
    route_change: RouteChange | None = None
    cut: Cut | None = None
    transport: Literal["datagram", "tcp"] = "datagram"

    @model_validator(mode="after")
    def _come_through(self) -> Self:
        if self.transport == "tcp" and self.loss == 1:
            raise ValueError("over tcp nothing ever arrives where loss is 1; give less, or a cut")
        return self

    def text(self) -> str:
        """The link as `parse_link` reads it."""
        return ",".join(_written(self))


def parse_link(text: str) -> LinkScene:
    """A link as a command line has it: "delay=40ms,loss=1%,cut.from=3s,cut.for=2s".

    Raises SceneError.
    """
    table: dict[str, Any] = {}
    for part in filter(None, text.split(",")):
        key, _, value = part.partition("=")
        name, dot, inner = key.strip().partition(".")
        known = table.setdefault(name, {} if dot else "")
        if isinstance(known, dict) != bool(dot):
            raise SceneError(f"--link {text!r}: {name} is given as a table and as a value")
        if dot:
            known[inner] = value.strip()
        else:
            table[name] = value.strip()
    return validate(table, LinkScene, where=f"--link {text!r}:")


def _written(section: Section, prefix: str = "") -> Iterator[str]:
    for name, field in type(section).model_fields.items():
        key, value = prefix + (field.alias or name), getattr(section, name)
        if isinstance(value, Section):
            yield from _written(value, key + ".")
        elif value is not None:
            unit = "ns" if name.endswith("_ns") else "bit/s" if name.endswith("_bit_per_s") else ""
            yield f"{key}={value}{unit}"


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


# Linux's least margin of a retransmission timeout over the round trip.
RTO_MARGIN_NS = 200_000_000
# Linux waits this share of the round trip for packets that may only be out of order (RACK).
REORDERING_WINDOW = 0.25
MAX_RTO_NS = 120_000_000_000


class TcpStream:
    """A TCP connection over one direction of a link, a packet a message.

    A packet that is lost, or its repeat, is repeated once the acknowledgement of the next one that
    comes through shows the gap: after the time between messages, a round trip and a reordering
    window (RACK, RFC 8985); where that would take longer, after the retransmission timeout,
    which then doubles (RFC 6298). After a timeout came through, whatever else was lost before is
    repeated a round trip later. All that follows waits for what is missing.

    The time to the next message is taken to be that since the last one, and the round trip twice
    the link's delay. Not modelled: lost acknowledgements, congestion window, slow start, pacing,
    the rate that repeats take, a sender that gives up.
    """

    def __init__(self, direction: Direction) -> None:
        self._direction = direction
        self._last_sent_ns: int | None = None
        self._last_arrival_ns = 0
        # When the latest repeat on a timeout that came through was sent, and acknowledged.
        self._repaired_ns = self._resumed_ns = 0

    def arrival_ns(self, now_ns: int, size_bytes: int) -> int:
        """When a message that is sent now can be read at the other end."""
        sent_ns = self._direction.queue(now_ns, size_bytes)
        arrival_ns = self._direction.fly(sent_ns)
        if arrival_ns is None:
            arrival_ns = self._repeat(sent_ns)
        self._last_sent_ns = sent_ns
        self._last_arrival_ns = max(self._last_arrival_ns, arrival_ns)
        return self._last_arrival_ns

    def _repeat(self, lost_ns: int) -> int:
        """When a message that was lost at its sending arrives after all."""
        direction, arrival_ns = self._direction, None
        round_trip_ns = 2 * direction.base_ns(lost_ns)
        rto_ns = round_trip_ns + RTO_MARGIN_NS
        noticed_after_ns = self._noticed_after_ns(lost_ns, round_trip_ns)
        if lost_ns < self._repaired_ns:
            lost_ns = self._resumed_ns
            arrival_ns = direction.fly(lost_ns)
        while arrival_ns is None:
            alive_ns = direction.outage_until(lost_ns) or lost_ns
            timeout_ns = lost_ns + rto_ns
            lost_ns = min(alive_ns + noticed_after_ns, timeout_ns)
            arrival_ns = direction.fly(lost_ns)
            if lost_ns == timeout_ns:
                rto_ns = min(2 * rto_ns, MAX_RTO_NS)
                if arrival_ns is not None:
                    self._repaired_ns, self._resumed_ns = lost_ns, lost_ns + round_trip_ns
        return arrival_ns

    def _noticed_after_ns(self, sent_ns: int, round_trip_ns: int) -> int:
        """How long until the acknowledgement of the next message shows that one is missing."""
        last_ns = self._last_sent_ns
        gap_ns = MAX_RTO_NS if last_ns is None else sent_ns - last_ns
        return gap_ns + round(round_trip_ns * (1 + REORDERING_WINDOW))


# What ZeroMQ, TCP and IP add to a short message: 2, 32 and 20 bytes.
HEADER_BYTES = 54


class MessageLink:
    """Data and control in one direction of a link, each message in one packet.

    As datagrams, data may be lost and overtake; control waits for the end of a cut and is never
    lost. As tcp, each of the two is a connection of its own.
    """

    def __init__(self, scene: LinkScene, seed: int, start_ns: int = 0) -> None:
        self._direction = Direction(scene, seed, start_ns)
        self._tcp = scene.transport == "tcp"
        self._data, self._control = TcpStream(self._direction), TcpStream(self._direction)
        self.lost_data = 0

    def data_arrival_ns(self, now_ns: int, size_bytes: int) -> int | None:
        """When a data message that is sent now arrives; None when it is lost."""
        size_bytes += HEADER_BYTES
        if self._tcp:
            return self._data.arrival_ns(now_ns, size_bytes)
        arrival_ns = self._direction.arrival_ns(now_ns, size_bytes)
        self.lost_data += arrival_ns is None
        return arrival_ns

    def control_arrival_ns(self, now_ns: int, size_bytes: int) -> int:
        """When a control message that is sent now arrives."""
        size_bytes += HEADER_BYTES
        if self._tcp:
            return self._control.arrival_ns(now_ns, size_bytes)
        passed_ns = self._direction.queue(now_ns, size_bytes)
        return self._direction.fly_surely(self._direction.cut_until(passed_ns) or passed_ns)


__all__ = ["Direction", "LinkScene", "MessageLink", "parse_link"]
