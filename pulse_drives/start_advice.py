"""Advice on drives that refuse to start, which every command that starts one gives."""

from collections.abc import Iterator
from contextlib import contextmanager

from protocol.errors import DriveError

OTHERWISE = "see docs/drives.md"
DISPLAY_TABLE = "[display.drive]"
_IN_USE = "another program uses it: end that one (fuser names it)"
_NO_WATCHDOG = "without this watchdog the drive would not stop by itself: use "

# Kind of DriveError, words of its text, and advice: the first entry that fits.
START_ADVICE = (
    ("unplugged", "pip install", ""),
    ("unplugged", "No such file", "check `port` in {table} and the cable: ls"
     " /dev/serial/by-id lists the ports of this machine"),
    ("unplugged", "Permission denied", "let this user open the port: sudo usermod -aG dialout"
     " $USER, then log in again"),
    ("unplugged", "busy", _IN_USE),
    ("unplugged", "temporarily unavailable", _IN_USE),
    ("unplugged", "Network is down", "bring the bus up, with the bit rate of the drive: sudo ip"
     " link set CHANNEL up type can bitrate BITRATE"),
    ("unplugged", "No such device", "check `channel` in {table} and the adapter: ip link"
     " lists the CAN interfaces of this machine"),
    ("unplugged", "interface", "check `interface` in {table}: a name that python-can has"),
    ("unplugged", "", "check the drive's cable, its adapter, and `port` or `channel` in"
     " {table}"),
    ("no answer", "", "check the drive's power and cable, `module` or `node`, and `baud` or"
     " `bitrate` in {table}"),
    ("wrong", "", "another device answers: check `port`, `module` and `host` in {table}"),
    ("garbled", "", "check that this is the drive's port, `baud` in {table}, the cable and"
     " its shield"),
    ("refused", "profile", "this is no drive of profile CiA 402: check `node` in {table}"),
    ("refused", "mode", "choose another `mode` in {table}, or a drive that takes speeds"),
    ("refused", "0x1016", _NO_WATCHDOG + "one that has a consumer heartbeat"),
    ("refused", "heartbeat", _NO_WATCHDOG + "a module that has a heartbeat, or set `watchdog` to a"
     " time that it takes"),
    ("refused", "", "compare this setting of the scene with the drive's manual"),
    ("not homed", "", "check the home switch and its wires, `homing` and `touch` in"
     " {table}"),
    ("not enabled", "", "check the drive's enable input and supply voltage"),
    ("not there", "", "check that the tip moves freely, then the motor's current and"
     " `microsteps`"),
    ("fault", "", "remove the cause, then switch the drive's power off and on"),
    # The text of this error is its advice.
    ("wrong way", "", ""),
)  # fmt: skip


def start_advice(error: DriveError, table: str = DISPLAY_TABLE) -> str:
    """Return advice on a drive that refused to start; empty where the error's text has it."""
    text = str(error)
    fitting = (
        advice for kind, words, advice in START_ADVICE if error.kind == kind and words in text
    )
    return next(fitting, OTHERWISE).replace("{table}", table)


@contextmanager
def advised(table: str = DISPLAY_TABLE) -> Iterator[None]:
    """Add advice to the text of a DriveError, within a `with`; table: the drive's in the scene."""
    try:
        yield
    except DriveError as error:
        advice = start_advice(error, table)
        raise DriveError(error.kind, f"{error}; {advice}" if advice else str(error)) from None
