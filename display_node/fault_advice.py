"""Advice on latched faults.

Every output that names a fault uses this table.
"""

import sys
from collections.abc import Iterable

from pulse_drives.start_advice import OTHERWISE

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


def latched(faults: Iterable[str]) -> list[str]:
    """Return the faults that hold the display until a new start, without sensors' notes."""
    return [fault for fault in faults if not fault.startswith((FILM_NOTE, SENSING_NOTE))]


def advise(fault: str) -> str:
    """Return advice on a latched fault, in one line."""
    advice = next((advice for words, advice in ADVICE if words in fault), OTHERWISE)
    return f"{advice}; then start the display again"


def name_faults(program: str, faults: Iterable[str]) -> bool:
    """Name latched faults on stderr, with advice; return whether there are any."""
    found = latched(faults)
    for fault in found:
        print(f"{program}: ended at the fault {fault!r}: {advise(fault)}", file=sys.stderr)
    return bool(found)
