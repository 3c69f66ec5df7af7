"""A CiA 402 drive and faults on its bus, in virtual time."""

from collections.abc import Iterator
from contextlib import nullcontext
from unittest.mock import patch

import can
import pytest

from display_node.hardware import build_display_drive
from protocol.errors import DriveError
from pulse_drives.cia402 import node as cia402_node
from pulse_drives.cia402.node import (
    EMERGENCY,
    HEARTBEAT,
    SPEED_TPDO,
    STATE_TPDO,
    TPDO1,
    TPDO2,
    Cia402Node,
)
from pulse_drives.cia402.state_machine import (
    Controlword,
    Mode,
    State,
    towards_enabled,
)
from pulse_drives.withdrawal import WithdrawalOutcome
from telepulse.emulators.cia402 import EmulatedCia402Drive
from telepulse.emulators.motor import EmulatedMotor
from tests.support.drive_benches import (
    FORCE_LIMIT_N,
    LAYER,
    Bench,
    cia402_scene,
    stepper,
    virtual_bench,
)

RATE_HZ = 400.0
NO_STATE = 0x0001  # a statusword
IGNORE = lambda *_: None  # noqa: E731


@pytest.fixture
def bench() -> Iterator[Bench]:
    with virtual_bench("cia402") as bench:
        yield bench


def send(bench: Bench, identifier: int, *messages: bytes) -> None:
    """Send frames as the drive."""
    for data in messages:
        bench.line.far.send(can.Message(arbitration_id=identifier + 1, data=data))


def test_from_a_fault_the_controlwords_lead_to_operation_enabled() -> None:
    controls, control = [], Controlword.DISABLE_VOLTAGE
    states = [State.FAULT] * 3
    states += [State.SWITCH_ON_DISABLED, State.READY, State.SWITCHED_ON, State.ENABLED]
    for state in states:
        control = towards_enabled(state, control)
        controls.append(int(control))
    # The reset's bit rises again, in case the first edge was not received.
    assert controls == [0x80, 0x00, 0x80, 0x06, 0x07, 0x0F, 0x0F]
    assert towards_enabled(State.QUICK_STOP, Controlword.QUICK_STOP) == Controlword.DISABLE_VOLTAGE


def test_a_silent_drive_is_a_fault_and_is_withdrawn(bench: Bench) -> None:
    bench.start(RATE_HZ, 0.05e-3)
    bench.emulator.silent = True
    bench.keep(RATE_HZ, lambda: bench.fault)
    assert "no answer" in bench.fault
    bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.UNCONFIRMED)
    bench.wait(lambda: bench.at_rest)
    assert bench.motor.tip_m < -0.2e-3
    bench.emulator.silent = False
    bench.start()
    assert bench.fault == ""


@pytest.mark.parametrize(
    ("abort_option", "state"), [(3, State.SWITCH_ON_DISABLED), (1, State.FAULT)]
)
def test_a_drive_that_missed_our_heartbeat_is_enabled_again_and_withdraws(
    bench: Bench, abort_option: int, state: State
) -> None:
    """The drive's watchdog acts first while this process stalls."""
    bench.start(RATE_HZ, 0.05e-3)
    bench.emulator.drive.abort_option = abort_option
    with patch.object(bench.line, "send"):
        bench.wait(lambda: bench.emulator.drive.state is state)
        assert bench.at_rest
    bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
    bench.wait(lambda: bench.at_rest)
    assert bench.motor.tip_m < -0.2e-3


def test_without_cyclic_velocity_the_drive_runs_in_profile_velocity() -> None:
    with virtual_bench("cia402", modes=(Mode.PROFILE_VELOCITY,)) as bench:
        bench.start()
        assert bench.emulator.drive.mode == Mode.PROFILE_VELOCITY
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz == pytest.approx(RATE_HZ))


@pytest.mark.parametrize(
    ("keys", "replaced", "words"),
    [
        (
            {"modes": (Mode.PROFILE_VELOCITY,), "mode": "cyclic"}, None,
            "no velocity mode that fits mode = 'cyclic'",
        ),
        ({"homing_method": 1}, None, "homing method 1 fails"),
        ({}, (EmulatedCia402Drive, "select", IGNORE), "does not take mode 9"),
        ({}, (EmulatedCia402Drive, "control", IGNORE), "still switch on disabled, no error code"),
        ({}, (EmulatedCia402Drive, "statusword", NO_STATE), "it sends no TPDO, no error code"),
        ({}, (Cia402Node, "read", lambda *_: 401), "has profile 401, not 402"),
        ({}, (EmulatedMotor, "homing", True), "no home within 15 s"),
    ],
)  # fmt: skip
def test_a_drive_that_cannot_be_used_is_refused(
    keys: dict[str, object], replaced: tuple[type, str, object] | None, words: str
) -> None:
    with (
        virtual_bench("cia402", **keys) as bench,
        patch.object(*replaced) if replaced else nullcontext(),
    ):
        with pytest.raises(DriveError, match=words):
            bench.drive.start()
        assert bench.fault


def test_a_drive_that_is_disabled_while_homing_is_named(bench: Bench) -> None:
    def force_n() -> float:
        if bench.motor.homing:
            bench.motor.fail("overtemperature")
        return 0.0

    with pytest.raises(DriveError, match="fault on its way home, overtemperature"):
        bench.drive.start(force_n)


def test_an_empty_address_is_named_in_one_line(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cia402_node, "SDO_TIMEOUT_S", 1e-3)
    other = build_display_drive(cia402_scene(node=9), stepper(), LAYER, FORCE_LIMIT_N)
    with pytest.raises(DriveError, match="no answer from node 9") as error:
        other.start()
    assert "\n" not in str(error.value)
    assert error.value.kind == "no answer"
    assert other.counts == {"not disabled: no answer": 1}


def test_malformed_and_implausible_messages_are_counted_and_ignored(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.start()
    send(bench, TPDO1, *(bytes(size) for size in (0, 1, 2, 3, 4, 5, 7)))
    send(bench, TPDO2, bytes(5))
    send(bench, EMERGENCY, b"", b"\x10", bytes(2), bytes(5))
    bench.keep(0.0, lambda: bench.drive.counts["malformed"] == 10)
    assert bench.fault == ""
    # A position and a speed far beyond the axis.
    send(bench, TPDO1, STATE_TPDO.pack(NO_STATE, 0), STATE_TPDO.pack(0x0637, -(2**31)))
    send(bench, TPDO2, SPEED_TPDO.pack(2**31 - 1, 0x4310))
    bench.keep(0.0, lambda: bench.drive.counts["implausible"] == 3)
    assert bench.fault == ""
    assert not bench.drive.status().moving
    # Without any plausible message, it is a fault.
    monkeypatch.setattr(EmulatedCia402Drive, "statusword", NO_STATE)
    bench.keep(0.0, lambda: bench.fault)
    assert bench.fault.startswith("garbled: no plausible TPDO for ")


def test_an_emergency_names_the_fault_and_many_are_not_stored(bench: Bench) -> None:
    bench.start()
    # The library's own listener would store them.
    with patch("canopen.emcy.EmcyConsumer.on_emcy") as store:
        send(bench, EMERGENCY, *[bytes(8)] * 200, (0x1234).to_bytes(2, "little") + bytes(6))
        send(bench, TPDO1, STATE_TPDO.pack(0x0218, 0))
        bench.wait(lambda: bench.fault)
        store.assert_not_called()
    assert bench.fault == "fault: error 0x1234"


def test_noise_from_a_can_adapter_is_counted_and_a_lost_bus_is_a_fault(bench: Bench) -> None:
    bench.start(RATE_HZ)
    (listener, *_) = bench.line.notifier.listeners
    for error in (ValueError("an odd line"), IndexError("a short line")):
        listener.on_error(error)
    assert bench.drive.counts == {"garbled": 2}
    bench.keep(0.0, lambda: not bench.drive.status().moving)
    assert bench.fault == ""
    bench.clock.thread(listener.on_error, OSError("it is gone"))
    bench.keep(0.0, lambda: bench.fault)
    assert bench.fault == "unplugged: node 1 on virtual c: it is gone"


def test_a_closed_bus_is_a_fault_and_is_counted(bench: Bench) -> None:
    bench.start(RATE_HZ)
    bench.line.unplugged = True
    bench.keep(RATE_HZ, lambda: bench.fault)
    assert "unplugged" in bench.fault
    bench.drive.command(RATE_HZ * bench.actuator.step_m)
    bench.drive.close()
    assert bench.drive.counts == {"not disabled: unplugged": 1, "not closed": 1}


@pytest.mark.parametrize("announced", [True, False], ids=["command of a master", "by itself"])
def test_a_drive_that_leaves_its_nmt_state_is_named_and_started_again(
    bench: Bench, announced: bool
) -> None:
    bench.start(RATE_HZ, 0.05e-3)
    began_ns = bench.clock.now_ns
    if announced:
        send_nmt(bench, 128)
    else:
        bench.emulator._node.nmt.state = "PRE-OPERATIONAL"
        bench.emulator._on_nmt(0, bytearray(), 0.0)
    bench.keep(RATE_HZ, lambda: bench.fault)
    assert bench.fault == "left its state: it is pre-operational (NMT)"
    # Before any time-out.
    assert bench.clock.now_ns - began_ns < 50_000_000
    bench.wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
    assert bench.motor.force_n == 0.0


def test_heartbeats_that_an_adapter_has_altered_end_nothing(bench: Bench) -> None:
    bench.start(RATE_HZ)
    send(bench, HEARTBEAT, b"\x7f", b"\x05", b"\x04", b"\x05", b"\x33", b"\x33", b"", b"\x05")
    bench.keep(0.0, lambda: bench.drive.counts["implausible"] == 2)
    assert bench.drive.counts["malformed"] == 1
    assert bench.fault == ""


def send_nmt(bench: Bench, command: int) -> None:
    """Send an NMT command to all nodes, as another master does."""
    frame = can.Message(arbitration_id=0, data=bytes([command, 0]), is_extended_id=False)
    for end in (bench.line, bench.line.far):
        end.notifier.receive(frame)
