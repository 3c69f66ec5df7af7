"""Drives on real lines: pseudo-terminals, CAN buses, slcan adapters, sockets, and noise on them.

tests/unit/pulse_drives has the tests that need no real line, in virtual time.
"""

import socket
import threading
from collections import Counter
from contextlib import closing

import pytest

from pulse_drives.tmcl.line import TmclLine
from pulse_drives.tmcl.module import Command, Parameter
from pulse_drives.withdrawal import WithdrawalOutcome
from telepulse.emulators.tmcl import DATAGRAM, EmulatedTmclModule
from tests.support.drive_benches import (
    emulated_motor,
    stepper,
    tmcl_scene,
)
from tests.system.drives.attempts import started

RATE_HZ = 400.0
# The longest times that a scene may state: beside other tests, a thread here may start late.
PATIENT = {"watchdog": "1 s", "reply_timeout": "200 ms"}


@pytest.mark.parametrize(
    "kind", ["tmcl", "tmcl-can", "tmcl-slcan", "cia402", "cia402-slcan", "stepdir"]
)
def test_a_drive_follows_commands_and_withdraws_without_them(kind: str) -> None:
    with started(kind) as bench:
        for rate_hz in (RATE_HZ, -RATE_HZ):
            bench.keep(rate_hz, lambda wanted=rate_hz: bench.motor.rate_hz == pytest.approx(wanted))
        bench.keep(RATE_HZ, lambda: bench.motor.tip_m > 0.05e-3)
        bench.wait(lambda: bench.fault)
        bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
        bench.wait(lambda: bench.at_rest)
        assert bench.motor.tip_m < -0.2e-3


@pytest.mark.parametrize("kind", ["tmcl-slcan", "cia402-slcan"])
def test_noise_from_a_can_adapter_is_only_counted(kind: str) -> None:
    with started(kind, RATE_HZ) as bench:
        for noise in (b"\xff\xfe\r", b"t18\r", b"t181Z\r", b"T12\a", b"t1818" + b"Q" * 40):
            counted = bench.drive.counts["garbled"]
            bench.line.write(noise)
            bench.keep(RATE_HZ / 4, lambda before=counted: bench.drive.counts["garbled"] > before)
            # The noise has been discarded once the drive answers again.
            garbled_ns = bench.clock.perf_counter_ns()
            bench.keep(RATE_HZ / 4, lambda at=garbled_ns: bench.drive.status().received_ns > at)
        bench.keep(0.0, lambda: not bench.drive.status().moving)
        assert bench.fault == ""


def test_a_module_behind_a_network_port_is_reached_by_url() -> None:
    scene = tmcl_scene(port="x")
    module = EmulatedTmclModule(scene, emulated_motor(scene, stepper(), 0))
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            peer, _ = server.accept()
            with peer:
                while data := peer.recv(DATAGRAM.size, socket.MSG_WAITALL):
                    peer.sendall(module.reply(data, 0))

        thread = threading.Thread(target=serve)
        thread.start()
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        scene = tmcl_scene(port=url, **PATIENT)
        with closing(TmclLine(scene, Counter())) as line:
            assert line.request(Command.SET_AXIS, Parameter.MICROSTEPS, 0, 6) == 6
            assert line.request(Command.GET_AXIS, Parameter.MICROSTEPS, 0) == 6
        thread.join()
