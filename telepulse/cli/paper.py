"""`telepulse paper`: the chapters of its report, in order."""

from pathlib import Path

from telepulse.cli.options import FolderOption, TablesOption, publish
from telepulse.reports.document import Report


def paper(out: FolderOption = Path("out/paper"), json: TablesOption = None) -> None:
    """Compute the paper's figures and numbers again, and explain the differences.

    Prints the tables and writes a page with all plots, in seconds.
    """
    publish(build_report, out, json)


def build_report() -> Report:
    """Compute every chapter. Raises SceneError or SourceError."""
    # Imported here: scipy's signals take long to import, and other commands do without.
    from telepulse.reports.paper import comparison, gain_units, pulse_spectrum, stability, stepper

    chapters = (
        comparison.chapter,
        comparison.contradictions,
        gain_units.chapter,
        pulse_spectrum.chapter,
        stepper.chapter,
        stability.chapter,
    )
    return Report(
        "A teletaction system's paper, computed again", [chapter() for chapter in chapters]
    )
