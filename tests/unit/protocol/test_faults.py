"""Faults as records: remedies and identity."""

from dataclasses import replace

import pytest

from protocol.faults import (
    REMEDIES,
    RESTING,
    START_AGAIN,
    Fault,
    FaultKind,
    Part,
    faults_of,
    internal_fault,
)

LATE = Fault(FaultKind.LATE, Part.FILM, "feedback late by 9 ms", 7, "cun")


@pytest.mark.parametrize("kind", [kind for kind in FaultKind if kind not in RESTING])
def test_every_kind_that_can_be_latched_has_a_remedy(kind: FaultKind) -> None:
    for part in Part:
        remedy = Fault(kind, part, "it broke").remedy
        assert remedy.endswith(f"; {START_AGAIN}")
        assert "{" not in remedy
        assert kind is FaultKind.UNKNOWN or REMEDIES[kind] != REMEDIES[FaultKind.UNKNOWN]


def test_the_remedy_of_a_load_cell_names_no_film() -> None:
    assert "load cell" in Fault(FaultKind.SILENT, Part.LOAD_CELL, "silent").remedy


def test_a_fault_is_the_same_one_whatever_its_figures() -> None:
    assert replace(LATE, cause="feedback late by 12 ms", at_ns=9).identity == LATE.identity
    for other in (
        replace(LATE, kind=FaultKind.SILENT),
        replace(LATE, part=Part.DRIVE),
        replace(LATE, contactor="guan"),
    ):
        assert other.identity != LATE.identity


def test_a_fault_is_read_from_its_json() -> None:
    assert faults_of({"faults": [LATE.to_dict()]}) == [LATE]
    assert str(LATE) == "cun: film: feedback late by 9 ms"


def test_an_exception_is_a_fault_with_its_place() -> None:
    try:
        raise MemoryError
    except MemoryError as error:
        fault = internal_fault(Part.DRIVE, "drive", error, 3)
    assert fault.kind is FaultKind.INTERNAL
    assert "MemoryError in test_faults.py:" in fault.cause
