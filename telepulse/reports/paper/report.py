"""The report of `telepulse paper`: its chapters in order."""

from telepulse.reports.document import Report
from telepulse.reports.paper import (
    comparison,
    contradictions,
    gain_units,
    pulse_spectrum,
    stability,
    stepper,
)

TITLE = "A teletaction system's paper, computed again"
CHAPTERS = (comparison, contradictions, gain_units, pulse_spectrum, stepper, stability)


def build_report() -> Report:
    """Compute every chapter. Raises SceneError or SourceError."""
    return Report(TITLE, tuple(module.chapter() for module in CHAPTERS))
