"""Advice on each latched fault."""

import re
from pathlib import Path

from display_node.fault_advice import FILM_NOTE, SENSING_NOTE, advise, latched
from display_node.plant.film_plausibility import FilmFault
from pulse_drives.start_advice import OTHERWISE

ROOT = Path(__file__).parents[3]
PACKAGES = ("display_node", "pulse_drives")


def named_faults() -> set[str]:
    """Return the texts of all faults that the display's code latches, without numbers."""
    paths = [path for package in PACKAGES for path in (ROOT / package).rglob("*.py")]
    sources = "\n".join(path.read_text(encoding="utf-8") for path in paths)
    safety = re.findall(r'\.fault\(\s*f?"([^"{]+)', sources)
    drive = re.findall(r'(?:DriveError\(|\.?_?fail\()\s*f?"([a-z][^":{]+)', sources)
    film = (fault.value.split("{")[0] for fault in FilmFault)
    return {*safety, *film, *(f"drive: {kind}" for kind in drive)}


def test_every_fault_in_the_code_has_advice() -> None:
    faults = named_faults()
    assert {"feedback lost", "drive: no answer", "drive: unplugged"} <= faults
    assert {fault for fault in faults if advise(fault).startswith(OTHERWISE)} <= {
        # These end a start, which gives its own advice, or follow the closing of a drive.
        "drive: stopped",
        "drive: not there",
    }


def test_notes_of_sensors_are_no_latched_faults() -> None:
    notes = [f"{FILM_NOTE}3 samples missing", f"{SENSING_NOTE}2 samples beyond the ADC's range"]
    assert latched(["feedback lost", *notes]) == ["feedback lost"]
