"""`telepulse study`: compute the studies."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from telepulse.cli.options import FolderOption, TablesOption, publish
from telepulse.cli.record_study import record
from telepulse.document import Report

# Begin of the finding that names the missed criteria of a study.
MISSED = "Missed:"
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS",
        help="Compute on the Dask cluster of this scheduler, not on this machine's cores.",
    ),
]
CheckOption = Annotated[
    bool, typer.Option("--check", help="End with exit status 1 where a criterion is missed.")
]
app = typer.Typer(no_args_is_help=True, help="Studies of the system by computation.")
app.command()(record)


def publish_checked(build: Callable[[], Report], out: Path, json: Path | None, check: bool) -> None:
    """Publish a report; with `check`, end with exit status 1 if a finding is what is missed."""
    reports: list[Report] = []

    def build_once() -> Report:
        reports.append(build())
        return reports[0]

    publish(build_once, out, json)
    if check and any(finding.startswith(MISSED) for finding in reports[0].findings):
        raise typer.Exit(1)


@app.command()
def press(
    out: FolderOption = Path("out/press"),
    json: TablesOption = None,
    scheduler: SchedulerOption = None,
    check: CheckOption = False,
) -> None:
    """Measure the press from the finger to the wrist: steps, stability, limits, over round trips.

    On several modelled wrists. Uses all cores; takes about six minutes on two.
    """
    from telepulse.reports.studies import press_report, press_scores

    effort = press_scores.PressEffort()
    publish_checked(
        lambda: press_report.report_press(press_scores.score_press(effort, scheduler), effort),
        out,
        json,
        check,
    )


@app.command()
def depth(
    out: FolderOption = Path("out/depth"),
    json: TablesOption = None,
    scheduler: SchedulerOption = None,
    check: CheckOption = False,
) -> None:
    """Sweep modelled wrists of several pressures, repeatedly: the best hold-down against the truth.

    Uses all cores; takes about a minute on two.
    """
    from telepulse.reports.studies import depth_study as study

    effort = study.DepthEffort()
    publish_checked(
        lambda: study.report_depths(study.score_depths(effort, scheduler), effort), out, json, check
    )
