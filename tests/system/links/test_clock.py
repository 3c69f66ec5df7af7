"""The clock over real TCP on the emulated link, with a sensing clock that is known to be wrong."""

import threading
import time
from statistics import median

import zmq

from display_node.reception.receiver import Receiver
from protocol import sockets
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from protocol.wire.messages import encode_control
from sensing_node.node import SensingNode
from sensing_node.scene import SensingScene, describe_stream, open_source
from telepulse.simulation.link_scene import parse_link
from tests.support.netem import emulate
from tests.support.tcp import needs_emulator

HOUR_NS = 3_600_000_000_000
SKEW = 200e-6
FOLLOWED_S = 8.0


@needs_emulator
def test_offset_within_1_ms_after_5_s_though_the_clock_is_200_ppm_fast() -> None:
    origin_ns = time.perf_counter_ns()

    def shown_ns(local_ns: int) -> int:
        return local_ns + HOUR_NS + round((local_ns - origin_ns) * SKEW)

    path = find_scene("radial")
    section = load_section(path, "sensing", SensingScene)
    with (
        emulate(parse_link("delay=20ms,jitter=3ms,loss=1%")) as link,
        open_source(section, path.parent) as source,
    ):
        address = f"tcp://{link.sensing.address}:5555"
        description = describe_stream(section, source)
        with link.sensing.entered():
            node = SensingNode(
                source, description, address, clock=lambda: shown_ns(time.perf_counter_ns())
            )
        thread = threading.Thread(target=node.run)
        # ZeroMQ's threads connect, so the context begins within the namespace.
        with link.display.entered():
            context: sockets.Context = zmq.Context()
            control = sockets.connect(context, zmq.DEALER, sockets.control_address(address))
            data = sockets.connect(context, zmq.SUB, address)
        thread.start()
        try:
            data.setsockopt(zmq.SUBSCRIBE, b"")
            receiver, seen = follow(control, data)
        finally:
            context.destroy(linger=0)
            node.stop()
            thread.join()
    errors_ns = [abs(remote_ns - shown_ns(local_ns)) for local_ns, remote_ns in seen]
    assert median(errors_ns) < 1_000_000
    assert receiver.clock.steps == 0
    assert receiver.rejected.keys() <= {"before_welcome", "before_clock"}


def follow(control: sockets.Socket, data: sockets.Socket) -> tuple[Receiver, list[tuple[int, int]]]:
    """Return a receiver after 8 s; from the fifth on, local times and its estimates of the remote
    ones."""
    receiver = Receiver("clock", channels=[0], late_target=0.01)
    began_ns: int | None = None
    seen: list[tuple[int, int]] = []
    while began_ns is None or time.perf_counter_ns() < began_ns + FOLLOWED_S * 1e9:
        for parts in sockets.receive_multipart(control):
            receiver.on_control(b"".join(parts), time.perf_counter_ns())
        for parts in sockets.receive_multipart(data):
            receiver.on_frame(b"".join(parts), time.perf_counter_ns())
        now_ns = time.perf_counter_ns()
        for request in receiver.requests(now_ns):
            sockets.send(control, encode_control(request))
        if began_ns is None and receiver.session is not None:
            began_ns = now_ns
        if began_ns is not None and now_ns > began_ns + 5_000_000_000:
            seen.append((now_ns, receiver.clock.remote_ns(now_ns)))
        sockets.wait_readable([control, data], 1_000_000)
    return receiver, seen
