"""Emergencies of any size and number, from a drive that goes on running."""

import can

from display_node.drives.cia402.node import EMERGENCY
from tests.support.drive_benches import shared_bus


def test_emergencies_without_a_code_are_counted() -> None:
    with shared_bus() as (bench, bus):
        for data in (b"", b"\x10", bytes(2), bytes(5)):
            bus.send(can.Message(arbitration_id=EMERGENCY + 1, is_extended_id=False, data=data))
        bench.keep(0.0, lambda: bench.drive.counts["malformed"] == 2)
        assert bench.drive.status().fault is None


def test_emergencies_without_end_are_not_kept() -> None:
    with shared_bus() as (bench, bus):
        for _ in range(200):
            bus.send(can.Message(arbitration_id=EMERGENCY + 1, is_extended_id=False, data=bytes(8)))
        bus.send(can.Message(arbitration_id=EMERGENCY + 1, is_extended_id=False, data=b""))
        bench.keep(0.0, lambda: bench.drive.counts["malformed"] == 1)
        assert bench.drive._node._node.emcy.log == []  # type: ignore[attr-defined]
