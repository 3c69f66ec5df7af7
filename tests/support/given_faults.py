"""Faults and notes that tests put into a summary."""

from protocol.faults import Fault, FaultKind, Note, Part

FILM_LOST = Fault(FaultKind.SILENT, Part.FILM, "feedback lost", 4)
MISSED = Note(Part.FILM, "3 samples missing")
