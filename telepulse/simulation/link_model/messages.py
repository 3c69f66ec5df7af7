"""Whole messages over one direction of a link, as datagrams or as TCP streams.

Messages over one TCP connection: none is lost, none overtakes another, some come late.
"""

from telepulse.simulation.link_model.direction import Direction
from telepulse.simulation.link_model.scene import LinkScene

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
