import re
import secrets
import signal
import time
from pathlib import Path

import msgpack
import numpy as np
import pytest
import zmq

from display_node.verdict import NOT_VALID_STATUS
from protocol.sockets import Context, control_address
from protocol.wire.messages import (
    ClockReply,
    ClockRequest,
    Frame,
    Hello,
    Welcome,
    decode_control,
    encode_control,
    encode_frame,
)
from protocol.wire.telemetry import TRACE, read_status, read_trace
from tests.support.live_display import (
    MODULE,
    PATIENCE_S,
    display_arguments,
    sensing_arguments,
    subscribe,
)
from tests.support.nodes import (
    RADIAL,
    assert_accounted,
    free_address,
    process,
    read_json,
    run,
    run_python,
)
from tests.support.streams import description

SENSING = "sensing_node.cli"
# Of the scene "radial".
TICK_NS = 2e6


@pytest.fixture
def telemetry(context: Context) -> zmq.Socket:
    """Return a socket that has subscribed to the telemetry of a display that may start later."""
    return subscribe(context, free_address())


def arguments(address: str, telemetry: zmq.Socket, *more: str) -> tuple[str, ...]:
    return display_arguments(address, telemetry.getsockopt_string(zmq.LAST_ENDPOINT), *more)


def test_telemetry_has_every_tick_and_ends_with_a_final_status(
    address: str, telemetry: zmq.Socket
) -> None:
    ticks, final = [], None
    end_s = time.monotonic() + PATIENCE_S
    with (
        process(MODULE, *arguments(address, telemetry, "--once")) as display,
        process(SENSING, *sensing_arguments(address, 3)),
    ):
        while final is None and time.monotonic() < end_s:
            try:
                topic, data = telemetry.recv_multipart()
            except zmq.Again:
                continue
            if topic == TRACE:
                ticks += read_trace(data)
            elif (status := read_status(data)).final:
                final = status
        assert display.wait(PATIENCE_S) == 0
    assert final is not None
    now_ns = np.concatenate([trace.now_ns for trace in ticks])
    assert (np.diff(now_ns) > 0).all()
    # Only ticks that were missed as deadlines are missing.
    ticks_spanned = round((now_ns[-1] - now_ns[0]) / TICK_NS) + 1
    assert ticks_spanned - len(now_ns) <= final.summary["loop"]["deadline_misses"] + 1
    felt_n = np.concatenate([trace.felt_n for trace in ticks])
    assert felt_n.min() >= 0
    assert 0.4 < felt_n.max() < 0.6


def test_a_sensing_node_of_another_version_is_refused_in_one_line(
    context: Context, address: str, telemetry: zmq.Socket
) -> None:
    control = context.socket(zmq.ROUTER)
    control.bind(control_address(address))
    with process(MODULE, *arguments(address, telemetry)) as display:
        answered = 0
        while answered < 2:
            assert control.poll(PATIENCE_S * 1000)
            peer, message = control.recv_multipart()
            if msgpack.unpackb(message)[1] == "hello":
                welcome = msgpack.unpackb(encode_control(Welcome(7, 0, description())))
                control.send_multipart([peer, msgpack.packb([1, *welcome[1:]])])
                answered += 1
        display.send_signal(signal.SIGTERM)
        _, errors = display.communicate(timeout=PATIENCE_S)
    assert display.returncode == 0
    assert errors.count("refused: the peer has version 1 of the protocol, this node version 2") == 1


def test_a_peer_that_sends_garbage_and_enormous_forces_is_felt_up_to_the_limit_only(
    context: Context, address: str, telemetry: zmq.Socket, tmp_path: Path
) -> None:
    summary = tmp_path / "display.json"
    # XPUB, because it receives the subscriptions.
    data, control = context.socket(zmq.XPUB), context.socket(zmq.ROUTER)
    data.bind(address)
    control.bind(control_address(address))
    with process(MODULE, *arguments(address, telemetry, "--json", str(summary))) as display:
        peer = b""
        while not data.poll(0):
            assert display.poll() is None
            peer = answer_for(control, seconds=0.1) or peer
        good = frame_now(0)
        for garbage in (
            *(secrets.token_bytes(size) for size in (0, 1, 10, 100, 10_000, 100_000)),
            good[:-1],
            good + b"\0",
            msgpack.packb([1, *msgpack.unpackb(good)[1:]]),
            frame_now(1, session=6),
            frame_now(2, force_n=float("nan")),
            frame_now(3, ahead_s=100.0),
            # Above the socket's limit: it closes the connection and must open a new one.
            secrets.token_bytes(300_000),
        ):
            data.send(garbage)
            control.send_multipart([peer, garbage])
        felt_n: list[float] = []
        for number in range(800):
            data.send(frame_now(100 + 5 * number, force_n=9e5))
            answer_for(control, seconds=0.005)
            while telemetry.poll(0):
                topic, message = telemetry.recv_multipart()
                if topic == TRACE:
                    felt_n += read_trace(message)[0].felt_n.tolist()
        assert display.poll() is None
        display.send_signal(signal.SIGTERM)
        assert display.wait(PATIENCE_S) == 0
    # 900 kN is a valid number.
    assert 2.4 < max(felt_n) <= 2.5
    rejected = read_json(summary)["rejected"]
    assert {"not_msgpack", "truncated", "version", "session", "not_finite", "timestamp"} <= set(
        rejected
    )


def answer_for(control: zmq.Socket, seconds: float) -> bytes:
    """Answer hellos and clock requests as a sensing node with this machine's clock.

    Returns the last peer that sent a request.
    """
    end_s, peer = time.monotonic() + seconds, b""
    while (left_ms := (end_s - time.monotonic()) * 1000) > 0:
        if not control.poll(left_ms):
            break
        peer, message = control.recv_multipart()
        now_ns = time.perf_counter_ns()
        match decode_control(message):
            case Hello():
                reply = encode_control(Welcome(7, 0, description()))
            case ClockRequest(t1_ns=t1_ns):
                reply = encode_control(ClockReply(7, t1_ns, now_ns, now_ns))
            case _:
                continue
        control.send_multipart([peer, reply])
    return peer


def frame_now(first: int, session: int = 7, force_n: float = 0.3, ahead_s: float = 0.0) -> bytes:
    t_ns = time.perf_counter_ns() - 4_000_000 + round(ahead_s * 1e9)
    return encode_frame(Frame(session, first, t_ns, 1_000_000, np.full((5, 1), force_n, "<f4")))


def test_a_port_without_a_listener_is_named_with_the_number_of_refusals(address: str) -> None:
    result = run(MODULE, str(RADIAL), "--connect", address, "--seconds", "3.5")
    assert result.returncode == NOT_VALID_STATUS
    reason = rf"nobody listens at {address}, refused (\d+) times"
    lines = re.findall(rf"^waiting: {reason}", result.stdout, re.MULTILINE)
    assert len(lines) >= 1
    assert [int(count) for count in lines] == sorted(map(int, lines))
    # No forces, no heart rate, no alert: there is nothing to feel.
    assert "mN" not in result.stdout
    assert "alert" not in result.stdout
    title, verdict = result.stdout.splitlines()[-2:]
    assert title.startswith("display node")
    remedy = "start the sensing node there, or check the address"
    assert re.fullmatch(
        rf"  This run is not valid: no pulse was felt; {reason}; {remedy}\.", verdict
    )


def test_with_three_paths_the_first_copy_of_each_frame_is_played(
    address: str, tmp_path: Path
) -> None:
    scene, summary = tmp_path / "paths.toml", tmp_path / "out.json"
    text = RADIAL.read_text(encoding="utf-8")
    scene.write_text(text.replace("[display]\n", "[display]\npaths = 3\n"), encoding="utf-8")
    options = ("--connect", address, "--json", str(summary), "--once", "--no-screen")
    with (
        process(MODULE, str(scene), *options, "--seconds", "30") as display,
        process(SENSING, *sensing_arguments(address, 3)),
    ):
        assert display.wait(PATIENCE_S + 10) == 0
    result = read_json(summary)
    assert_accounted(result["samples"])
    assert result["samples"]["lost"] == 0
    # The three paths may have been connected at slightly different times.
    assert 1.5 < result["frames"]["copies"] / result["frames"]["received"] <= 2
    assert result["rejected"] == {}


LOADED_IN_THE_LOOP = """
import sys
from telepulse.scene import load_scene
from telepulse.simulation.virtual_time import Simulation
simulation = Simulation(load_scene(sys.argv[1]), 1)
before = set(sys.modules)
for _ in simulation.ticks(1.5):
    pass
print(sorted(set(sys.modules) - before))
"""


@pytest.mark.smoke
@pytest.mark.parametrize("scene", ["radial", "announce", "press"])
def test_no_module_is_loaded_in_the_loop(scene: str) -> None:
    """Loading takes 100 ms, and delays the clock's first exchanges: it was 10 ms off for 3 s."""
    loaded = run_python("-c", LOADED_IN_THE_LOOP, scene)
    assert loaded.stdout == "[]\n", loaded.stderr
