"""`telepulse paper`: compute the figures of the paper again."""

from pathlib import Path

from telepulse.cli.options import FolderOption, TablesOption, publish
from telepulse.document import Report


def paper(out: FolderOption = Path("out/paper"), json: TablesOption = None) -> None:
    """Recompute the results of Dargahi et al. 2008, and explain where they differ from the paper.

    Prints the tables and writes a page with all plots.
    """
    publish(build_paper, out, json)


def build_paper() -> Report:
    """Compute every chapter on the paper, in order. Raises SceneError or SourceError."""
    # Imported here: matplotlib and scipy take long to import, and other commands do without.
    from telepulse.paper import comparison, gain_units, pulse_spectrum, stability, stepper

    chapters = (
        comparison.chapter(),
        comparison.contradictions(),
        gain_units.chapter(),
        pulse_spectrum.chapter(),
        stepper.chapter(),
        *stability.chapters(),
    )
    return Report("Dargahi, Xie and Ji (2008), recomputed", chapters)
