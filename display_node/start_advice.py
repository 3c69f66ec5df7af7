"""Advice on a drive that cannot be started: one table for every command that starts one."""

from collections.abc import Iterator
from contextlib import contextmanager

from display_node.fault_advice import OTHERWISE
from protocol.errors import DriveError

_IN_USE = "another program uses it: end that one (fuser names it)"
_NO_WATCHDOG = "without this watchdog the drive would not stop by itself: use "

# Kind of DriveError, words of its text, and what to do: the first entry that fits.
ADVICE = (
    ("unplugged", "pip install", ""),
    ("unplugged", "No such file", "check `port` in [display.drive] and the cable: ls"
     " /dev/serial/by-id lists the ports of this machine"),
    ("unplugged", "Permission denied", "let this user open the port: sudo usermod -aG dialout"
     " $USER, then log in again"),
    ("unplugged", "busy", _IN_USE),
    ("unplugged", "temporarily unavailable", _IN_USE),
    ("unplugged", "Network is down", "bring the bus up, with the bit rate of the drive: sudo ip"
     " link set CHANNEL up type can bitrate BITRATE"),
    ("unplugged", "No such device", "check `channel` in [display.drive] and the adapter: ip link"
     " lists the CAN interfaces of this machine"),
    ("unplugged", "interface", "check `interface` in [display.drive]: a name that python-can has"),
    ("unplugged", "", "check the drive's cable, its adapter, and `port` or `channel` in"
     " [display.drive]"),
    ("no answer", "", "check the drive's power and cable, `module` or `node`, and `baud` or"
     " `bitrate` in [display.drive]"),
    ("wrong", "", "another device answers: check `port`, `module` and `host` in [display.drive]"),
    ("garbled", "", "check that this is the drive's port, `baud` in [display.drive], the cable and"
     " its shield"),
    ("refused", "profile", "this is no drive of profile CiA 402: check `node` in [display.drive]"),
    ("refused", "mode", "choose another `mode` in [display.drive], or a drive that takes speeds"),
    ("refused", "0x1016", _NO_WATCHDOG + "one that has a consumer heartbeat"),
    ("refused", "heartbeat", _NO_WATCHDOG + "a module that has a heartbeat, or set `watchdog` to a"
     " time that it takes"),
    ("refused", "", "compare this setting of the scene with the drive's manual"),
    ("not homed", "", "check the home switch and its wires, `homing` and `touch` in"
     " [display.drive]"),
    ("not enabled", "", "check the drive's enable input and supply voltage"),
    ("not there", "", "check that the tip moves freely, then the motor's current and"
     " `microsteps`"),
    ("fault", "", "remove the cause, then switch the drive's power off and on"),
    # Its own text says what to look at.
    ("wrong way", "", ""),
)  # fmt: skip


def start_advice(error: DriveError) -> str:
    """Return advice on a drive that refused to start; empty where the error's text holds it."""
    text = str(error)
    fitting = (what for kind, words, what in ADVICE if error.kind == kind and words in text)
    return next(fitting, OTHERWISE)


@contextmanager
def advised() -> Iterator[None]:
    """Add to a DriveError what to do about it, within a `with`."""
    try:
        yield
    except DriveError as error:
        advice = start_advice(error)
        raise DriveError(error.kind, f"{error}; {advice}" if advice else str(error)) from None
