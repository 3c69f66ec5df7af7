"""Advice on latched faults and on drives that refuse to start, and the exit status for faults.

Every output that names a fault, and every command that starts a drive, uses these tables.
"""

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from protocol.errors import DriveError

# Exit status of a display, or of a demo, that ended at a latched fault.
FAULT_STATUS = 3
# Prefixes of those entries of a summary's `faults` that are notes on a sensor and latch nothing.
FILM_NOTE, SENSING_NOTE = "film's sensor: ", "sensing node: "
# Words of a fault's text, and advice: the first entry that fits.
ADVICE = (
    ("withdrawal", "the tip may still press: switch the drive's power off, take the finger away"),
    ("wrong way", "check `inverted` in the scene and the motor's wires: telepulse bench"),
    ("following error", "the tip does not move as commanded: check that it moves freely, then the"
     " motor's current and microsteps: telepulse bench"),
    ("film reads", "film and drive contradict each other: telepulse calibrate, telepulse bench"),
    ("felt force", "check the film (telepulse calibrate) and the drive's direction"
     " (telepulse bench)"),
    ("feedback is not a number", "check the film's sensor and its calibration in the scene"),
    ("feedback late", "check the film's sensor, its cable and the latency in [display.film]:"
     " telepulse bench measures it"),
    ("feedback lost", "check the film's sensor and its cable"),
    ("loop overrun", "this host stopped the loop: display-node --doctor names what helps"),
    ("no command", "this host stopped the loop: display-node --doctor names what helps"),
    ("no answer", "check the drive's power, cable, address and bit rate"),
    ("no position", "the drive's answers come late: check its line, address and bit rate"),
    ("unplugged", "check the drive's cable and port"),
    ("garbled", "check the drive's cable, shield and bit rate"),
    ("not homed", "check the home switch and `homing` in the scene"),
    ("not enabled", "check the drive's enable input and supply voltage"),
    ("refused", "the drive rejects a setting of the scene: compare it with the drive's manual"),
    ("fault", "the drive stopped itself: remove the cause, then switch its power off and on"),
)  # fmt: skip
OTHERWISE = "see docs/drives.md"


def latched(faults: Iterable[str]) -> list[str]:
    """Return the faults that hold the display until a new start, without sensors' notes."""
    return [fault for fault in faults if not fault.startswith((FILM_NOTE, SENSING_NOTE))]


def advise(fault: str) -> str:
    """Return advice on a latched fault, in one line."""
    advice = next((advice for words, advice in ADVICE if words in fault), OTHERWISE)
    return f"{advice}; then start the display again"


def end_at_faults(program: str, faults: Iterable[str]) -> None:
    """Name latched faults on stderr and end with `FAULT_STATUS`; return where there are none."""
    found = latched(faults)
    for fault in found:
        print(f"{program}: ended at the fault {fault!r}: {advise(fault)}", file=sys.stderr)
    if found:
        raise SystemExit(FAULT_STATUS)


_IN_USE = "another program uses it: end that one (fuser names it)"
_NO_WATCHDOG = "without this watchdog the drive would not stop by itself: use "

# Kind of DriveError, words of its text, and advice: the first entry that fits.
START_ADVICE = (
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
    # The text of this error is its advice.
    ("wrong way", "", ""),
)  # fmt: skip


def start_advice(error: DriveError) -> str:
    """Return advice on a drive that refused to start; empty where the error's text has it."""
    text = str(error)
    fitting = (
        advice for kind, words, advice in START_ADVICE if error.kind == kind and words in text
    )
    return next(fitting, OTHERWISE)


@contextmanager
def advised() -> Iterator[None]:
    """Add advice to the text of a DriveError, within a `with`."""
    try:
        yield
    except DriveError as error:
        advice = start_advice(error)
        raise DriveError(error.kind, f"{error}; {advice}" if advice else str(error)) from None
