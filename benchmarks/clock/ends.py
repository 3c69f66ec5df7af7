"""Programs at both ends of the link: `python -m benchmarks.clock.ends END ...`.

Those at the display print a line every 0.1 s: time since the first contact in s, error in ms and,
for ours, the stated uncertainty in ms and the error of the skew in ppm.
"""

import sys
import time
from collections.abc import Callable

import zmq

from benchmarks.peers.others import load_lsl
from display_node.reception.receiver import Receiver
from protocol import sockets
from protocol.config.scene import load_section
from protocol.config.scene_file import find_scene
from protocol.wire.messages import encode_control
from sensing_node.node import SensingNode
from sensing_node.scene import SensingScene, describe_stream, open_source

# Large enough to reveal a clock that is mistaken for another.
AHEAD_NS = 3_600_000_000_000
EVERY_NS = 100_000_000
TICK_NS = 1_000_000
RESOLVE_S = 20.0


def scaled_ns(local_ns: int, origin_ns: str, skew_ppm: str) -> int:
    """Return the wrong clock's time when the machine's monotonic clock shows `local_ns`.

    origin_ns: time at which the wrong clock was ahead by exactly an hour.
    """
    return local_ns + AHEAD_NS + round((local_ns - int(origin_ns)) * float(skew_ppm) * 1e-6)


def sense(address: str, skew_ppm: str, origin_ns: str, seconds: str) -> None:
    """Run a sensing node whose clock is wrong."""
    path = find_scene("radial")
    section = load_section(path, "sensing", SensingScene)
    with open_source(section, path.parent) as source:
        description = describe_stream(section, source)
        SensingNode(
            *(source, description, address),
            lambda: scaled_ns(time.perf_counter_ns(), origin_ns, skew_ppm),
        ).run(float(seconds))


def follow(address: str, skew_ppm: str, origin_ns: str, seconds: str) -> None:
    """Run a display's receiver, which receives the whole stream."""
    context: sockets.Context = zmq.Context()
    control = sockets.connect(context, zmq.DEALER, sockets.control_address(address))
    data = sockets.connect(context, zmq.SUB, address)
    data.subscribe(b"")
    receiver = Receiver("clock", channels=[0], late_target=0.01)
    began_ns: int | None = None
    next_ns = time.perf_counter_ns()
    while began_ns is None or next_ns < began_ns + float(seconds) * 1e9:
        for message in sockets.receive_parts(control):
            receiver.on_control(message, time.perf_counter_ns())
        for message in sockets.receive_parts(data):
            receiver.on_frame(message, time.perf_counter_ns())
        for request in receiver.requests(time.perf_counter_ns()):
            sockets.send(control, encode_control(request))
        local_ns, clock = time.perf_counter_ns(), receiver.clock
        if began_ns is None and receiver.session is not None:
            began_ns = next_ns = local_ns
        if began_ns is not None and local_ns >= next_ns and clock.ready:
            next_ns += EVERY_NS
            truth_ns = scaled_ns(local_ns, origin_ns, skew_ppm)
            error_ns = clock.remote_ns(local_ns) - truth_ns
            _say(
                (local_ns - began_ns) * 1e-9,
                error_ns * 1e-6,
                clock.uncertainty_ns(local_ns) * 1e-6,
                clock.skew_ppm - float(skew_ppm),
            )
        sockets.wait_readable([control, data], TICK_NS)
    context.destroy(linger=0)


def lsl_outlet(peer: str, seconds: str) -> None:
    """Publish a Lab Streaming Layer stream."""
    pylsl = load_lsl(peer, "clock")
    info = pylsl.StreamInfo("pulse", "force", 1, 200, pylsl.cf_float32, "clock")
    outlet = pylsl.StreamOutlet(info)
    end_s = time.monotonic() + float(seconds)
    while time.monotonic() < end_s:
        outlet.push_sample([0.0])
        time.sleep(0.005)


def lsl_inlet(peer: str, seconds: str) -> None:
    """Follow the stream; both ends use this machine's clock, so the true correction is 0."""
    pylsl = load_lsl(peer, "clock")
    found = pylsl.resolve_byprop("source_id", "clock", timeout=RESOLVE_S)
    if not found:
        raise SystemExit("no LSL stream was found")
    inlet = pylsl.StreamInlet(found[0], processing_flags=0)
    began_s = time.monotonic()
    inlet.time_correction(timeout=RESOLVE_S)
    while (since_s := time.monotonic() - began_s) < float(seconds):
        _say(since_s, inlet.time_correction(timeout=RESOLVE_S) * 1e3)
        time.sleep(EVERY_NS * 1e-9)


def _say(*figures: float) -> None:
    print(*(f"{figure:.6f}" for figure in figures), flush=True)


ENDS: dict[str, Callable[..., None]] = {
    "sense": sense,
    "follow": follow,
    "lsl_outlet": lsl_outlet,
    "lsl_inlet": lsl_inlet,
}

if __name__ == "__main__":
    ENDS[sys.argv[1]](*sys.argv[2:])
