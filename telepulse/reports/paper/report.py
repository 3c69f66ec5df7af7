"""The report of `telepulse paper`: its chapters in their order."""

from telepulse.reports.document import Report
from telepulse.reports.paper import (
    comparison,
    contradictions,
    readings_chapter,
    spectrum_chapter,
    stability_chapter,
)
from telepulse.reports.paper import stepper_chapter as bench_chapter
from telepulse.reports.paper.results import compute

TITLE = "A teletaction system's paper, computed again"


def build_report() -> Report:
    """Compute everything. Raises SceneError or SourceError."""
    results = compute()
    return Report(
        TITLE,
        (
            comparison.chapter(results),
            contradictions.chapter(results),
            readings_chapter.chapter(results),
            spectrum_chapter.chapter(results),
            bench_chapter.chapter(),
            stability_chapter.chapter(),
        ),
    )
