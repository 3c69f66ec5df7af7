"""A display's end of the sockets, for tests of the real sensing node."""

import zmq

from protocol.sockets import control_address
from protocol.wire.messages import (
    Bye,
    Control,
    Frame,
    Hello,
    Welcome,
    decode_control,
    decode_frame,
    encode_control,
)

PATIENCE_MS = 20_000


class Client:
    """A raw ZeroMQ peer of a sensing node."""

    def __init__(self, address: str) -> None:
        self._context = zmq.Context()
        self.data = self._connected(zmq.SUB, address)
        self.data.subscribe(b"")
        self.control = self._connected(zmq.DEALER, control_address(address))

    def _connected(self, kind: int, address: str) -> zmq.Socket[bytes]:
        connected = self._context.socket(kind)
        connected.setsockopt(zmq.RCVTIMEO, PATIENCE_MS)
        connected.connect(address)
        return connected

    def ask(self, message: Control) -> Control:
        self.control.send(encode_control(message))
        return decode_control(self.control.recv())

    def join(self, name: str = "raw") -> Welcome:
        welcome = self.ask(Hello(name))
        assert isinstance(welcome, Welcome)
        return welcome

    def frames_until(self, samples_sent: int) -> list[Frame]:
        """Return every frame up to the one with the stream's last sample."""
        frames = [decode_frame(self.data.recv())]
        while frames[-1].first_sample + len(frames[-1].values) < samples_sent:
            frames.append(decode_frame(self.data.recv()))
        return frames

    def bye(self) -> Bye:
        """Return the sensing node's bye, and answer it, so that the node ends."""
        bye = decode_control(self.control.recv())
        assert isinstance(bye, Bye)
        self.control.send(encode_control(bye))
        return bye

    def close(self) -> None:
        self._context.destroy(linger=0)
