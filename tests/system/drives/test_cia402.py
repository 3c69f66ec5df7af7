"""Faults of a CiA 402 drive on its bus."""

from unittest.mock import patch

import can
import pytest

from display_node.drives.axis import build_axis
from display_node.drives.cia402.drive import Cia402Drive
from display_node.drives.cia402.node import SPEED_TPDO, STATE_TPDO, TPDO1, TPDO2, Cia402Node
from display_node.drives.cia402.state_machine import Control, Mode, State, state_of, towards_enabled
from display_node.drives.withdrawal import WithdrawalOutcome
from protocol.errors import DriveError
from tests.support.drive_benches import (
    FORCE_LIMIT_N,
    LAYER,
    cia402_bench,
    cia402_scene,
    shared_bus,
    slcan_bench,
    stepper,
    wait,
)

RATE_HZ = 400.0


def test_every_statusword_is_one_state() -> None:
    for word in range(1 << 16):
        assert sum(word & mask == bits for mask, bits in (s.value for s in State)) <= 1
    assert state_of(0x0637) is State.ENABLED
    assert state_of(0x0650) is State.SWITCH_ON_DISABLED
    assert state_of(0x0218) is State.FAULT
    assert state_of(0x0001) is None


def test_from_a_fault_the_controlwords_lead_to_operation_enabled() -> None:
    led = []
    control = Control.DISABLE_VOLTAGE
    for state in (
        State.FAULT,
        State.FAULT,
        State.FAULT,
        State.SWITCH_ON_DISABLED,
        State.READY,
        State.SWITCHED_ON,
        State.ENABLED,
    ):
        control = towards_enabled(state, control)
        led.append(int(control))
    # The reset's bit rises again where the first rise was not heard.
    assert led == [0x80, 0x00, 0x80, 0x06, 0x07, 0x0F, 0x0F]
    assert towards_enabled(State.QUICK_STOP, Control.QUICK_STOP) == Control.DISABLE_VOLTAGE


def test_a_silent_drive_is_a_fault_and_stops_by_itself() -> None:
    with cia402_bench() as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)
        bench.emulator.silent = True
        bench.keep(RATE_HZ, lambda: bench.drive.status().fault is not None)
        assert "no answer" in str(bench.drive.status().fault)
        wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.UNCONFIRMED)
        wait(lambda: bench.at_rest)
        # Unheard, it is commanded all the way off the finger.
        assert bench.motor.tip_m < -0.2e-3
        bench.emulator.silent = False
        bench.drive.start()
        assert bench.drive.status().fault is None


def test_a_drive_that_missed_our_heartbeat_is_enabled_again_and_withdraws() -> None:
    with cia402_bench() as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.tip_m > 0.05e-3)
        # Its own watchdog is first where this process stands still.
        with patch.object(Cia402Node, "_send"):
            wait(lambda: bench.motor.tripped)
            wait(lambda: bench.at_rest)
        wait(lambda: bench.drive.status().withdrawal is WithdrawalOutcome.WITHDRAWN)
        wait(lambda: bench.at_rest)
        assert bench.motor.tip_m < -0.2e-3


@pytest.mark.parametrize(
    ("abort_option", "state"), [(3, State.SWITCH_ON_DISABLED), (1, State.FAULT)]
)
def test_what_a_missed_heartbeat_does_is_the_drives_option(abort_option: int, state: State) -> None:
    with cia402_bench() as bench:
        bench.drive.start()
        bench.emulator.drive.abort_option = abort_option
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)
        with patch.object(Cia402Node, "_send"):
            wait(lambda: bench.emulator.drive.state is state)
            assert bench.at_rest


def test_without_cyclic_velocity_it_falls_back_to_profile_velocity() -> None:
    with cia402_bench(modes=(Mode.PROFILE_VELOCITY,)) as bench:
        bench.drive.start()
        assert bench.emulator.drive.mode == Mode.PROFILE_VELOCITY
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz == pytest.approx(RATE_HZ))


def test_a_drive_without_the_mode_is_refused() -> None:
    with (
        cia402_bench(modes=(Mode.PROFILE_VELOCITY,), mode="cyclic") as bench,
        pytest.raises(DriveError, match="no velocity mode that fits mode = 'cyclic'"),
    ):
        bench.drive.start()


def test_a_mode_that_is_not_taken_is_refused() -> None:
    with cia402_bench() as bench:
        bench.emulator.drive.select = lambda mode: None
        with pytest.raises(DriveError, match="does not take mode 9"):
            bench.drive.start()
        assert bench.drive.status().fault is not None


def test_a_home_that_is_not_found_is_said() -> None:
    with (
        cia402_bench(homing_method=1) as bench,
        pytest.raises(DriveError, match="homing method 1 fails"),
    ):
        bench.drive.start()


def test_nobody_at_the_address_is_said_in_one_line() -> None:
    with cia402_bench() as bench:
        other = Cia402Drive(
            scene := cia402_scene(channel=bench.emulator._network.bus.channel_id, node=9),
            build_axis(scene, stepper(), LAYER, FORCE_LIMIT_N),
        )
        with pytest.raises(DriveError, match="no answer from node 9") as error:
            other.start()
        assert "\n" not in str(error.value)
        assert error.value.kind == "no answer"


def test_a_bus_that_is_not_there_is_said() -> None:
    scene = cia402_scene(interface="no-such-interface")
    drive = Cia402Drive(scene, build_axis(scene, stepper(), LAYER, FORCE_LIMIT_N))
    with pytest.raises(DriveError, match=r"no-such-interface .* cannot be opened"):
        drive.start()


def test_malformed_pdos_are_counted_and_harmless() -> None:
    with shared_bus() as (bench, bus):
        for size in (0, 1, 2, 3, 4, 5, 7):
            bus.send(can.Message(arbitration_id=TPDO1 + 1, is_extended_id=False, data=bytes(size)))
        bench.keep(0.0, lambda: bench.drive.counts["malformed"] == 7)
        assert bench.drive.status().fault is None


def test_what_no_drive_reports_is_counted_and_not_used() -> None:
    with shared_bus() as (bench, bus):
        node = bench.drive._node  # type: ignore[attr-defined]
        # A statusword of no state, a position and a speed far beyond the axis.
        for identifier, data in (
            (TPDO1 + 1, STATE_TPDO.pack(0x0001, 0)),
            (TPDO1 + 1, STATE_TPDO.pack(0x0637, -(2**31))),
            (TPDO2 + 1, SPEED_TPDO.pack(2**31 - 1, 0x4310)),
        ):
            bus.send(can.Message(arbitration_id=identifier, is_extended_id=False, data=data))
        bench.keep(0.0, lambda: bench.drive.counts["implausible"] == 3)
        assert bench.drive.status().fault is None
        assert node.state is State.ENABLED
        assert node.error_code == 0


def test_noise_from_a_can_adapter_is_counted_and_the_drive_goes_on() -> None:
    with slcan_bench() as bench:
        bench.drive.start()
        bench.keep(RATE_HZ, lambda: bench.motor.rate_hz > 0)
        for noise in (b"\xff\xfe\r", b"t18\r", b"t181Z\r", b"T12\a", b"t1818" + b"Q" * 40):
            counted = bench.drive.counts["garbled"]
            bench.emulator._network.bus._port.write(noise)
            bench.keep(RATE_HZ / 4, lambda before=counted: bench.drive.counts["garbled"] > before)
        # What it says next is understood again.
        bench.keep(0.0, lambda: not bench.drive.status().moving)
        assert bench.drive.status().fault is None


def test_a_closed_bus_is_a_fault_and_no_crash() -> None:
    with cia402_bench() as bench:
        bench.drive.start()
        bench.drive._node._network.bus.shutdown()  # type: ignore[attr-defined]
        bench.keep(RATE_HZ, lambda: bench.drive.status().fault is not None)
        assert "unplugged" in str(bench.drive.status().fault)
        bench.drive.command(RATE_HZ * bench.actuator.step_m)
