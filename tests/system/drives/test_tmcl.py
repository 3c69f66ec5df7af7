"""Faults on the line to a TMCL module."""

import os
import pty
import socket
import threading
import time
import tty

import pytest

from display_node.drives.axis import build_axis
from display_node.drives.tmcl.drive import TmclDrive
from display_node.drives.tmcl.line import TmclLine
from display_node.drives.tmcl.module import Command, Parameter
from display_node.drives.withdrawal import WithdrawalOutcome
from protocol.errors import DriveError
from telepulse.emulators.tmcl import DATAGRAM, EmulatedTmclModule, checksum
from tests.support.drive_benches import (
    FORCE_LIMIT_N,
    LAYER,
    emulated_motor,
    stepper,
    tmcl_bench,
    tmcl_scene,
    wait,
)

RATE_HZ = 400.0


@pytest.mark.parametrize(
    ("on_can", "answers", "named"),
    [
        (False, "none", "no answer"),
        (False, "late", "no answer"),
        (False, "wrong", "wrong"),
        (False, "garbled", "garbled"),
        (True, "none", "no answer"),
        (True, "late", "no answer"),
        (True, "wrong", "wrong"),
    ],
)
def test_answers_that_are_none_stop_the_motor_and_are_counted(
    on_can: bool, answers: str, named: str
) -> None:
    with tmcl_bench(on_can) as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)
        bench.emulator.late_s = 0.15
        bench.emulator.answer_mode = answers
        bench.keep(RATE_HZ, lambda: bench.drive.status().fault is not None)
        assert bench.drive.counts[named] > 0
        # None of what a module says late or wrongly is taken for an answer to something else.
        bench.emulator.answer_mode = "right"
        wait(lambda: bench.drive.status().withdrawal is not WithdrawalOutcome.UNDER_WAY)
        wait(lambda: bench.at_rest)
        assert bench.motor.tip_m < 0
        bench.drive.start()
        assert bench.drive.status().fault is None


def test_a_few_missing_answers_are_counted_and_nothing_else() -> None:
    with tmcl_bench() as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)
        bench.emulator.answer_mode = "garbled"
        bench.keep(RATE_HZ, lambda: bench.drive.counts["garbled"] >= 2)
        bench.emulator.answer_mode = "right"
        missed = bench.drive.counts["garbled"]
        bench.keep(-RATE_HZ, lambda: bench.motor.rate_hz < 0)
        assert bench.drive.status().fault is None
        assert missed >= 2


def test_a_module_that_was_not_ready_yet_is_asked_again() -> None:
    with tmcl_bench(reply_timeout="20 ms") as bench:
        bench.emulator.answer_mode = "none"
        ready = threading.Timer(0.2, setattr, (bench.emulator, "answer_mode", "right"))
        ready.start()
        bench.drive.start()
        ready.join()
        assert bench.drive.counts["no answer"] > 3
        assert bench.drive.status().fault is None
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)


def test_a_pulled_cable_is_named_and_the_module_stops_by_itself() -> None:
    with tmcl_bench() as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)
        bench.unplug()
        bench.keep(RATE_HZ, lambda: bench.drive.status().fault is not None)
        assert "unplugged" in str(bench.drive.status().fault)
        wait(lambda: bench.at_rest)
        assert bench.motor.tripped
        with pytest.raises(DriveError, match="cannot be opened"):
            bench.drive.start()


def test_what_is_not_there_is_said_in_one_line() -> None:
    drive = TmclDrive(
        scene := tmcl_scene(port="/dev/no-such-port"),
        build_axis(scene, stepper(), LAYER, FORCE_LIMIT_N),
    )
    with pytest.raises(DriveError, match="/dev/no-such-port cannot be opened") as error:
        drive.start()
    assert "\n" not in str(error.value)
    bus = tmcl_scene(interface="no-such-interface", channel="x")
    with pytest.raises(DriveError, match="no-such-interface x cannot be opened"):
        TmclLine(bus)


def test_a_module_that_refuses_is_not_started() -> None:
    with tmcl_bench(homing_method=65) as bench:
        with pytest.raises(DriveError, match="refused") as error:
            bench.drive.start()
        assert error.value.kind == "refused"
        assert bench.drive.status().fault is not None
        assert bench.at_rest


def test_noise_from_a_can_adapter_is_counted_and_the_drive_goes_on() -> None:
    with tmcl_bench(by_slcan=True) as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)
        port = bench.line._bus._port
        for noise in (b"\xff\xfe\r", b"t00\r", b"t002Z\r", b"T12\a"):
            counted = bench.drive.counts["garbled"]
            port.write(noise)
            bench.keep(RATE_HZ / 4, lambda before=counted: bench.drive.counts["garbled"] > before)
            # By then it has thrown away what came with the noise, and is answered again.
            garbled_ns = time.monotonic_ns()
            bench.keep(RATE_HZ / 4, lambda at=garbled_ns: bench.drive.status().received_ns > at)
        bench.keep(0.0, lambda: not bench.drive.status().moving)
        assert bench.drive.status().fault is None


def test_a_noisy_line_is_no_drive() -> None:
    master, slave = pty.openpty()
    tty.setraw(slave)
    noise = bytes((17 * i) & 0xFF for i in range(256))
    over = threading.Event()

    def babble() -> None:
        while not over.is_set():
            if os.read(master, 64):
                os.write(master, noise)

    thread = threading.Thread(target=babble)
    thread.start()
    line = TmclLine(tmcl_scene(port=os.ttyname(slave)))
    try:
        for _ in range(5):
            with pytest.raises(DriveError) as error:
                line.request(Command.GET_AXIS, Parameter.ACTUAL_POSITION, 0)
            assert error.value.kind in ("garbled", "wrong", "refused")
        assert line.counts.total() == 5
    finally:
        over.set()
        line._interface._send(2, 1, b"\0")
        thread.join()
        line.close()
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize("offset", range(9))
def test_a_reply_with_a_wrong_byte_anywhere_is_no_answer(offset: int) -> None:
    scene = tmcl_scene(port="loop://")
    line = TmclLine(scene)
    right = bytearray(DATAGRAM.pack(2, 1, 100, Command.GET_AXIS, 7, 0))
    right[-1] = checksum(bytes(right[:-1]))
    replies = [bytearray(right), right]
    replies[0][offset] ^= 0x10
    line._interface._port.write = lambda _: inject(bytes(replies.pop(0)))

    def inject(data: bytes) -> None:
        for byte in data:
            line._interface._port.queue.put(bytes([byte]))

    try:
        with pytest.raises(DriveError, match="checksum"):
            line.request(Command.GET_AXIS, Parameter.ACTUAL_POSITION, 0)
        assert line.request(Command.GET_AXIS, Parameter.ACTUAL_POSITION, 0) == 7
    finally:
        line.close()


def test_a_module_behind_a_network_port_is_reached_by_url() -> None:
    scene_there = tmcl_scene(port="x")
    motor = emulated_motor(scene_there, stepper())
    module = EmulatedTmclModule(scene_there, motor)
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        peer, _ = server.accept()
        with peer:
            while data := peer.recv(DATAGRAM.size, socket.MSG_WAITALL):
                peer.sendall(module.reply(data, 0))

    thread = threading.Thread(target=serve)
    thread.start()
    line = TmclLine(tmcl_scene(port=f"socket://127.0.0.1:{server.getsockname()[1]}"))
    try:
        assert line.request(Command.SET_AXIS, Parameter.MICROSTEPS, 0, 6) == 6
        assert line.request(Command.GET_AXIS, Parameter.MICROSTEPS, 0) == 6
    finally:
        line.close()
        thread.join()
        server.close()
