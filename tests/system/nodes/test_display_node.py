import time

import numpy as np
import pytest
import zmq

from protocol.sockets import Context
from protocol.wire.telemetry import TRACE, read_status, read_trace
from tests.support.live_display import (
    MODULE,
    PATIENCE_S,
    display_arguments,
    sensing_arguments,
    subscribe,
)
from tests.support.nodes import (
    free_address,
    process,
    run_python,
)

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
        process(SENSING, *sensing_arguments(address, 6)),
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
