"""A display's end of the sockets, for tests of the real sensing node."""

import zmq

from protocol import sockets
from protocol.security.link_keys import ClientKeys
from protocol.wire import messages as wire

PATIENCE_MS = 20_000


class Client:
    """A raw ZeroMQ peer of a sensing node."""

    def __init__(self, address: str, keys: ClientKeys | None = None) -> None:
        self._context, self._keys = zmq.Context(), keys
        self.data = self._connected(zmq.SUB, address)
        self.data.subscribe(b"")
        self.control = self._connected(zmq.DEALER, sockets.control_address(address))

    def _connected(self, kind: int, address: str) -> zmq.Socket[bytes]:
        connected = self._context.socket(kind)
        connected.setsockopt(zmq.RCVTIMEO, PATIENCE_MS)
        if self._keys is not None:
            self._keys.protect(connected)
        connected.connect(address)
        return connected

    def ask(self, message: wire.ControlMessage) -> wire.ControlMessage:
        self.control.send(wire.encode_control(message))
        return wire.decode_control(self.control.recv())

    def join(self, name: str = "raw") -> wire.Welcome:
        welcome = self.ask(wire.Hello(name))
        assert isinstance(welcome, wire.Welcome)
        return welcome

    def frames_until(self, samples_sent: int) -> list[wire.Frame]:
        """Return every frame up to that of the stream's last sample."""
        frames = [wire.decode_frame(self.data.recv())]
        while frames[-1].first_sample + len(frames[-1].values) < samples_sent:
            frames.append(wire.decode_frame(self.data.recv()))
        return frames

    def bye(self) -> wire.Bye:
        """Receive the sensing node's bye and send it back, so that the node ends."""
        bye = wire.decode_control(self.control.recv())
        assert isinstance(bye, wire.Bye)
        self.control.send(wire.encode_control(bye))
        return bye

    def close(self) -> None:
        self._context.destroy(linger=0)


class KeyedClient:
    """A peer with keys or without, which requests the stream and stores what it receives."""

    def __init__(self, context: sockets.Context, address: str, keys: ClientKeys | None) -> None:
        control_address = sockets.control_address(address)
        self._control = sockets.connect(context, zmq.DEALER, control_address, keys)
        self._data = sockets.connect(context, zmq.SUB, address, keys)
        self._data.subscribe(b"")
        self.answers: list[bytes] = []
        self.frames: list[bytes] = []

    def request(self) -> None:
        sockets.send(self._control, wire.encode_control(wire.Hello("raw")))
        self.answers += sockets.receive_parts(self._control)
        self.frames += sockets.receive_parts(self._data)
