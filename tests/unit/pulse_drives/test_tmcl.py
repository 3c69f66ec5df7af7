"""Faults on the line to a TMCL module, in virtual time."""

from collections import Counter
from collections.abc import Callable, Iterator
from unittest.mock import patch

import pytest

from protocol.errors import DriveError
from pulse_drives.tmcl.line import TmclLine
from pulse_drives.tmcl.module import Command, Parameter
from pulse_drives.withdrawal import WithdrawalOutcome
from telepulse.emulators.motor import EmulatedMotor
from telepulse.emulators.tmcl import DATAGRAM, INVALID_VALUE, checksum
from tests.support.drive_benches import Bench, tmcl_scene, virtual_bench

RATE_HZ = 400.0


@pytest.fixture
def bench() -> Iterator[Bench]:
    with virtual_bench("tmcl") as bench:
        yield bench


def datagram(command: int, value: int, status: int = 100) -> bytes:
    body = DATAGRAM.pack(2, 1, status, command, value, 0)[:-1]
    return body + bytes([checksum(body)])


def answer_otherwise(bench: Bench, command: int, kinds: tuple[int, ...], reply: bytes) -> None:
    """Replace the module's reply to a command of some types."""
    usual: Callable[[bytes, int], bytes] = bench.emulator.reply

    def answer(request: bytes, now_ns: int) -> bytes:
        replaced = request[1] == command and request[2] in kinds
        return reply if replaced else usual(request, now_ns)

    bench.emulator.reply = answer


@pytest.mark.parametrize(
    ("kind", "answers", "named"),
    [
        ("tmcl", "silent", "no answer"), ("tmcl", "late", "no answer"), ("tmcl", "wrong", "wrong"),
        ("tmcl", "garbled", "garbled"), ("tmcl-can", "silent", "no answer"),
        ("tmcl-can", "late", "no answer"), ("tmcl-can", "wrong", "wrong"),
    ],
)  # fmt: skip
def test_missing_and_wrong_answers_are_a_fault_and_are_counted(
    kind: str, answers: str, named: str
) -> None:
    with virtual_bench(kind) as bench:
        bench.start(RATE_HZ)
        bench.emulator.late_s = 0.15
        bench.emulator.answer_mode = answers
        bench.keep(RATE_HZ, lambda: bench.fault)
        assert bench.drive.counts[named] > 0
        # No late or wrong reply is taken for the answer to another request.
        bench.emulator.answer_mode = "right"
        bench.wait(lambda: bench.drive.status().withdrawal is not WithdrawalOutcome.UNDER_WAY)
        bench.wait(lambda: bench.at_rest)
        assert bench.motor.tip_m < 0
        bench.start()
        assert bench.fault == ""


@pytest.mark.parametrize("kind", ["tmcl", "tmcl-can"])
def test_late_answers_are_a_fault_although_the_module_obeys(kind: str) -> None:
    # The answer to each velocity arrives in time for the next one, but no answer with a position.
    with virtual_bench(kind) as bench:
        bench.start(RATE_HZ)
        bench.emulator.late_s, bench.emulator.answer_mode = 0.03, "late"
        began_ns = bench.clock.now_ns
        bench.keep(RATE_HZ / 100, lambda: bench.fault)
        assert bench.clock.now_ns - began_ns < 300_000_000
        bench.wait(lambda: bench.motor.tip_m < 0 and bench.at_rest)


def test_a_few_missing_answers_are_only_counted(bench: Bench) -> None:
    bench.start(RATE_HZ)
    bench.emulator.answer_mode = "garbled"
    bench.keep(RATE_HZ, lambda: bench.drive.counts["garbled"] >= 2)
    bench.emulator.answer_mode = "right"
    bench.keep(-RATE_HZ, lambda: bench.motor.rate_hz < 0)
    assert bench.fault == ""


def test_requests_to_a_module_that_is_not_ready_are_repeated(bench: Bench) -> None:
    bench.emulator.answer_mode = "silent"
    ready_ns = bench.clock.now_ns + 200_000_000
    bench.clock.at(ready_ns, lambda: setattr(bench.emulator, "answer_mode", "right"))
    bench.start(RATE_HZ)
    assert bench.drive.counts["no answer"] > 3
    assert bench.fault == ""


def test_without_a_cable_the_module_stops_by_itself(bench: Bench) -> None:
    bench.start(RATE_HZ)
    bench.line.unplugged = True
    bench.keep(RATE_HZ, lambda: bench.fault)
    assert "unplugged" in bench.fault
    bench.wait(lambda: bench.at_rest)
    assert bench.motor.tripped


@pytest.mark.parametrize(
    ("command", "kinds", "status", "words"),
    [
        (Command.REFERENCE_SEARCH, (0,), INVALID_VALUE, "command 13, type 0 is refused"),
        (Command.GET_GLOBAL, (68,), 100, "the module's heartbeat is 7 ms, not 50"),
        (Command.GET_AXIS, (10, 11), INVALID_VALUE, "does not report its home switch"),
        (Command.GET_AXIS, (Parameter.DRIVER_FLAGS,), 100, "overtemperature"),
    ],
)
def test_a_module_that_cannot_be_used_is_refused(
    bench: Bench, command: int, kinds: tuple[int, ...], status: int, words: str
) -> None:
    answer_otherwise(bench, command, kinds, datagram(command, 7, status))
    with pytest.raises(DriveError, match=words):
        bench.drive.start()
    assert bench.fault
    bench.wait(lambda: bench.at_rest)


def test_a_search_on_the_side_without_a_switch_is_refused() -> None:
    with virtual_bench("tmcl", homing_method=65) as bench:
        with pytest.raises(DriveError, match="refused") as error:
            bench.drive.start()
        assert error.value.kind == "refused"


def test_a_search_without_an_end_is_ended(bench: Bench) -> None:
    with (
        patch.object(EmulatedMotor, "homing", True),
        pytest.raises(DriveError, match="no home switch within 15 s"),
    ):
        bench.drive.start()
    bench.wait(lambda: bench.at_rest)


def test_noise_from_a_can_adapter_is_counted_and_the_drive_goes_on() -> None:
    with virtual_bench("tmcl-can") as bench:
        bench.start(RATE_HZ)
        for count in range(1, 4):
            bench.bus.errors.append(ValueError("an odd line"))
            bench.keep(RATE_HZ / 4, lambda n=count: bench.drive.counts["garbled"] == n)
        # The second error comes while the line is drained after the first.
        bench.bus.errors.extend([ValueError("an odd line"), IndexError("a short line")])
        bench.keep(RATE_HZ / 4, lambda: bench.drive.counts["garbled"] == 5)
        bench.keep(0.0, lambda: not bench.drive.status().moving)
        assert bench.fault == ""
        assert bench.bus.flushed == 4
        bench.bus.errors.append(OSError("it is gone"))
        bench.keep(0.0, lambda: bench.fault)
        assert bench.fault.startswith("unplugged: virtual c: it is gone")


class Replies:
    """A port with one prepared reply to each request."""

    in_waiting = 0

    def __init__(self, *replies: bytes) -> None:
        self._replies = list(replies)

    def write(self, data: bytes) -> None:
        pass

    def read(self, size: int) -> bytes:
        return self._replies.pop(0) if size == 9 and self._replies else b""

    def reset_input_buffer(self) -> None:
        pass


def on_line(*replies: bytes) -> TmclLine:
    with patch("serial.serial_for_url", lambda *_, **__: Replies(*replies)):
        return TmclLine(tmcl_scene(port="x"), Counter())


@pytest.mark.parametrize("offset", range(9))
def test_a_reply_with_a_wrong_byte_anywhere_is_no_answer(offset: int) -> None:
    right = datagram(Command.GET_AXIS, 7)
    spoilt = bytearray(right)
    spoilt[offset] ^= 0x10
    line = on_line(bytes(spoilt), right)
    with pytest.raises(DriveError, match="checksum"):
        line.request(Command.GET_AXIS, Parameter.ACTUAL_POSITION, 0)
    assert line.request(Command.GET_AXIS, Parameter.ACTUAL_POSITION, 0) == 7


def test_a_reply_to_another_request_is_ignored_unless_none_follows() -> None:
    other, right = datagram(Command.ROTATE_RIGHT, 1), datagram(Command.GET_AXIS, -7)
    line = on_line(other, other, right, other)
    assert line.request(Command.GET_AXIS, Parameter.ACTUAL_POSITION, 0) == -7
    with pytest.raises(DriveError, match="an answer by 1 to 2, about command 1") as error:
        line.request(Command.GET_AXIS, Parameter.ACTUAL_POSITION, 0)
    assert (error.value.kind, line.counts) == ("wrong device", {"wrong": 3})
