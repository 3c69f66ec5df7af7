"""`telepulse paper`: the chapters of its report, in order."""

from pathlib import Path

from telepulse.cli.options import FolderOption, TablesOption, publish
from telepulse.reports.document import Report


def paper(out: FolderOption = Path("out/paper"), json: TablesOption = None) -> None:
    """Recompute the results of Dargahi et al. 2008, and explain where they differ from the paper.

    Prints the tables and writes a page with all plots.
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
    return Report("Dargahi, Xie and Ji (2008), recomputed", [chapter() for chapter in chapters])
