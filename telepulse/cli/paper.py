"""`telepulse paper`."""

from pathlib import Path

from telepulse.cli.options import FolderOption, TablesOption, publish


def paper(out: FolderOption = Path("out/paper"), json: TablesOption = None) -> None:
    """Compute the paper's figures and numbers again, and explain the differences.

    Prints the tables and writes a page with all plots, in seconds.
    """
    # Imported here: scipy's signals take long to import, and other commands do without.
    from telepulse.reports.paper.report import build_report

    publish(build_report, out, json)
