"""Whole messages over one direction of a link, as datagrams or as TCP streams."""

from telepulse.link.direction import Direction
from telepulse.link.scene import LinkScene
from telepulse.link.tcp_stream import TcpStream

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
