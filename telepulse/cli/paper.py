"""`telepulse paper`: compute the figures of the paper again."""

from pathlib import Path

from telepulse.cli.options import FolderOption, TablesOption, publish


def paper(out: FolderOption = Path("out/paper"), json: TablesOption = None) -> None:
    """Recompute the results of Dargahi et al. 2008, and explain where they differ from the paper.

    Prints the tables and writes a page with all plots.
    """
    # Imported here, since matplotlib and scipy take long to import: --help does without.
    from telepulse.paper.report import build_paper

    publish(build_paper, out, json)
