"""The data connections of a simulated display: as many as its scene's `paths`, over one link.

Each is a TCP stream of its own, which meets losses of its own. As datagrams, a stream has no
connection, and one copy of each frame is sent.
"""

from display_node.reception.endpoint import ANSWER_NS
from display_node.reception.failover import Failover
from display_node.reception.redundancy import Redundancy
from display_node.scene import DisplayScene
from protocol.summary_tables import DataConnections
from telepulse.simulation.link_model import MessageLink
from telepulse.simulation.link_scene import LinkScene

# A new connection delivers after its handshakes (decision 28).
HANDSHAKES = 4


class ParallelPaths:
    """Data connections over a link, and with `paths = "auto"` the decision on their number.

    frame_ns: duration of a frame.
    """

    def __init__(
        self, link: MessageLink, scene: LinkScene, display: DisplayScene, frame_ns: int
    ) -> None:
        self._link = link
        tcp = scene.transport == "tcp"
        self.count = (display.paths or 1) if tcp else 1
        self._redundancy = Redundancy(display.late_target) if tcp and not display.paths else None
        self._round_trip_ns = 2 * scene.delay_ns
        if self._redundancy is not None:
            failover = Failover()
            failover.set_timeouts(frame_ns, max(ANSWER_NS, 3 * self._round_trip_ns))
            self._redundancy.set_times(frame_ns, self._round_trip_ns, failover.silence_ns)
        # Time from which each connection carries frames.
        self._open_ns = [0] * self.count
        self._first = self._merged = self._polled_ns = 0

    def arrivals_ns(self, now_ns: int, size_bytes: int) -> list[tuple[int, int]]:
        """Return path and arrival of each copy of a frame that is sent now and is not lost."""
        arrivals_ns = []
        for path, open_ns in enumerate(self._open_ns):
            if now_ns >= open_ns:
                arrival_ns = self._link.data_arrival_ns(now_ns, size_bytes, path)
                if arrival_ns is not None:
                    arrivals_ns.append((path, arrival_ns))
        return arrivals_ns

    def received(self, path: int) -> None:
        """Count a frame that came over a path."""
        self._first += path == 0
        self._merged += 1

    def poll(self, now_ns: int) -> None:
        """Open and close connections where that is due; call each tick."""
        redundancy = self._redundancy
        if redundancy is None:
            return
        if self._merged:
            redundancy.received(self._first, self._merged, now_ns, self._polled_ns)
            self._first = self._merged = 0
        self._polled_ns = now_ns
        if redundancy.change(now_ns):
            opened_ns = now_ns + HANDSHAKES * self._round_trip_ns
            self._open_ns = self._open_ns[: redundancy.paths]
            self._open_ns += [opened_ns] * (redundancy.paths - len(self._open_ns))
            self.count = max(self.count, redundancy.paths)

    def data_connections(self) -> DataConnections:
        """Return the counts of the connections, and of the stalls for which some were opened."""
        if self._redundancy is None:
            return DataConnections(len(self._open_ns))
        return DataConnections(len(self._open_ns), self._redundancy.opened, self._redundancy.stalls)
