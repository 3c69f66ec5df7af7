"""The emulated TMCL module, byte by byte, beside PyTrinamic's codec."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pytrinamic.tmcl import TMCLReply, TMCLRequest

from pulse_drives.tmcl.module import Command, Parameter
from telepulse.emulators.motor import EmulatedMotor
from telepulse.emulators.tmcl import (
    INVALID_COMMAND,
    INVALID_VALUE,
    WRONG_CHECKSUM,
    WRONG_TYPE,
    DatagramSplitter,
    EmulatedTmclModule,
)
from tests.support.drive_benches import emulated_motor, stepper, tmcl_scene

GET_POSITION = bytes.fromhex("01 06 01 00 00 00 00 00 08")
AT_ZERO = bytes.fromhex("02 01 64 06 00 00 00 00 6d")
ROTATE_1000 = bytes.fromhex("01 01 00 00 00 00 03 e8 ed")
ROTATE_BACK = bytes.fromhex("01 01 00 00 ff ff fc 18 14")


def module_and_motor(**keys: object) -> tuple[EmulatedTmclModule, EmulatedMotor]:
    scene = tmcl_scene(port="x", **keys)
    motor = emulated_motor(scene, stepper(), 0)
    return EmulatedTmclModule(scene, motor), motor


@pytest.fixture
def module() -> EmulatedTmclModule:
    return module_and_motor()[0]


def request(command: int, kind: int = 0, motor: int = 0, value: int = 0) -> bytes:
    data: bytes = TMCLRequest(1, command, kind, motor, value).to_buffer()
    return data


def test_replies_to_the_bytes_that_the_makers_codec_writes(module: EmulatedTmclModule) -> None:
    assert request(Command.GET_AXIS, Parameter.ACTUAL_POSITION) == GET_POSITION
    assert request(Command.ROTATE_RIGHT, value=1000) == ROTATE_1000
    assert request(Command.ROTATE_RIGHT, value=-1000) == ROTATE_BACK
    assert module.reply(GET_POSITION, 0) == AT_ZERO
    assert module.reply(ROTATE_1000, 0).hex(" ") == "02 01 64 01 00 00 03 e8 53"
    # After 100 ms at 1000 microsteps a second.
    assert module.reply(GET_POSITION, 100_000_000).hex(" ") == "02 01 64 06 00 00 00 64 d1"
    module.reply(ROTATE_BACK, 100_000_000)
    # From there 200 ms the other way.
    assert module.reply(GET_POSITION, 300_000_000).hex(" ") == "02 01 64 06 ff ff ff 9c 06"


@pytest.mark.parametrize(
    ("data", "status"),
    [
        (request(77), INVALID_COMMAND),
        (request(Command.GET_AXIS, 99), WRONG_TYPE),
        (request(Command.SET_AXIS, Parameter.MICROSTEPS, value=9), INVALID_VALUE),
        (request(Command.ROTATE_RIGHT, motor=3), INVALID_VALUE),
        (request(Command.SET_GLOBAL, 68, motor=1, value=50), WRONG_TYPE),
        (request(Command.REFERENCE_SEARCH, 9), WRONG_TYPE),
        (request(Command.ROTATE_RIGHT, value=1000)[:-1] + b"\0", WRONG_CHECKSUM),
    ],
)
def test_unknown_requests_are_refused(module: EmulatedTmclModule, data: bytes, status: int) -> None:
    reply = TMCLReply.from_buffer(module.reply(data, 0))
    assert reply.status == status
    assert reply.is_checksum_correct()


@pytest.mark.parametrize("offset", range(10))
@pytest.mark.parametrize("noise", [b"\0", b"\xff\x01", b"\x01\x06\x01", bytes(8)])
def test_after_noise_anywhere_and_a_pause_it_answers_again(
    module: EmulatedTmclModule, offset: int, noise: bytes
) -> None:
    datagrams = DatagramSplitter()
    spoilt = GET_POSITION[:offset] + noise + GET_POSITION[offset:]
    for data in datagrams.feed(spoilt, 1_000_000_000):
        module.reply(data, 1_000_000_000)
    (data,) = datagrams.feed(GET_POSITION, 1_010_000_000)
    assert module.reply(data, 1_010_000_000) == AT_ZERO


@given(st.binary(max_size=200), st.integers(1, 9))
def test_no_bytes_break_it_and_none_that_are_no_request_move_it(data: bytes, cut: int) -> None:
    (module, motor), datagrams, valid = module_and_motor(), DatagramSplitter(), 0
    for start in range(0, len(data), cut):
        for whole in datagrams.feed(data[start : start + cut], 0):
            reply = module.reply(whole, 0)
            valid += bool(reply) and reply[2] != WRONG_CHECKSUM
    motor.advance(100_000_000)
    assert valid or motor.rate_hz == 0.0
