"""Advice on drives that refuse to start, which every command that starts one gives."""

from collections.abc import Iterator
from contextlib import contextmanager

from protocol.errors import DriveError
from protocol.faults import FaultKind

OTHERWISE = "see docs/drives.md"
DISPLAY_TABLE = "[display.drive]"

START_ADVICE = {
    # The text of these errors is its advice.
    FaultKind.LIBRARY_MISSING: "",
    FaultKind.WRONG_WAY: "",
    FaultKind.NO_SUCH_PORT: "check `port` in {table} and the cable: ls /dev/serial/by-id lists the"
    " ports of this machine",
    FaultKind.NOT_ALLOWED: "let this user open the port: sudo usermod -aG dialout $USER, then log"
    " in again",
    FaultKind.BUSY: "another program uses it: end that one (fuser names it)",
    FaultKind.BUS_DOWN: "bring the bus up, with the bit rate of the drive: sudo ip link set CHANNEL"
    " up type can bitrate BITRATE",
    FaultKind.NO_SUCH_BUS: "check `channel` in {table} and the adapter: ip link lists the CAN"
    " interfaces of this machine",
    FaultKind.NO_SUCH_INTERFACE: "check `interface` in {table}: a name that python-can has",
    FaultKind.UNPLUGGED: "check the drive's cable, its adapter, and `port` or `channel` in {table}",
    FaultKind.NO_ANSWER: "check the drive's power and cable, `module` or `node`, and `baud` or"
    " `bitrate` in {table}",
    FaultKind.WRONG_DEVICE: "another device answers: check `port`, `module` and `host` in {table}",
    FaultKind.GARBLED: "check that this is the drive's port, `baud` in {table}, the cable and its"
    " shield",
    FaultKind.NOT_CIA402: "this is no drive of profile CiA 402: check `node` in {table}",
    FaultKind.NO_SPEED_MODE: "choose another `mode` in {table}, or a drive that takes speeds",
    FaultKind.NO_WATCHDOG: "without this watchdog the drive would not stop by itself: use a drive"
    " that has one (CiA 402: a consumer heartbeat, TMCL: a heartbeat), or set `watchdog` to a time"
    " that it takes",
    FaultKind.REFUSED: "compare this setting of the scene with the drive's manual",
    FaultKind.NOT_HOMED: "check the home switch and its wires, `homing` and `touch` in {table}",
    FaultKind.NOT_ENABLED: "check the drive's enable input and supply voltage",
    FaultKind.NOT_THERE: "check that the tip moves freely, then the motor's current and"
    " `microsteps`",
    FaultKind.DRIVE_FAULT: "remove the cause, then switch the drive's power off and on",
    FaultKind.INTERNAL: "this is an error in a program, not of the bench: report it with this line;"
    " if the tip may press, switch the drive's power off",
}


def start_advice(error: DriveError, table: str = DISPLAY_TABLE) -> str:
    """Return advice on a drive that refused to start; empty where the error's text has it."""
    return START_ADVICE.get(error.kind, OTHERWISE).replace("{table}", table)


@contextmanager
def advised(table: str = DISPLAY_TABLE) -> Iterator[None]:
    """Add advice to the text of a DriveError, within a `with`; table: the drive's in the scene."""
    try:
        yield
    except DriveError as error:
        advice = start_advice(error, table)
        raise DriveError(error.kind, f"{error}; {advice}" if advice else str(error)) from None
