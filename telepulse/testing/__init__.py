"""Conformance tests of plug-ins, for the tests of whoever writes one.

Each function takes the section model of a kind and its keys as in a scene, with the kind. It raises
ConformanceError with a line that says what does not hold. They need no test framework, and nothing
of telepulse's own tests:

    from telepulse.testing import check_source

    def test_conformance() -> None:
        check_source(SineScene, {"kind": "sine", "frequency": "2 Hz"})
"""

from telepulse.testing.actuator import check_actuator
from telepulse.testing.conformance import ConformanceError, check_entry_point
from telepulse.testing.drive import check_drive
from telepulse.testing.predictor import check_predictor
from telepulse.testing.sensor import check_sensor
from telepulse.testing.source import check_source

__all__ = [
    "ConformanceError",
    "check_actuator",
    "check_drive",
    "check_entry_point",
    "check_predictor",
    "check_sensor",
    "check_source",
]
