"""`telepulse study`: compute the studies."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from telepulse.cli.options import FolderOption, TablesOption, publish
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
def integrators(out: FolderOption = Path("out/integrators"), json: TablesOption = None) -> None:
    """Compare integration methods of the paper's actuator in its loop: cost per step against error.

    Takes about half a minute. python-control is included if it is installed.
    """
    from telepulse.parallel import in_one_thread
    from telepulse.reports.studies import integrator_scores as study
    from telepulse.reports.studies.integrator_report import report_integrators

    effort = study.IntegratorEffort()
    publish(
        lambda: report_integrators(in_one_thread(study.score_integrators, effort), effort),
        out,
        json,
    )


@app.command()
def playout(
    out: FolderOption = Path("out/playout"),
    json: TablesOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Compare methods of setting the playout delay: delay against late frames.

    The best delay that a whole trace permits is shown beside them.

    Uses all cores; takes about a minute on two.
    """
    from telepulse.reports.studies import playout_scores as study
    from telepulse.reports.studies.playout_report import report_playout

    effort = study.PlayoutEffort(curves=study.CURVES)
    publish(lambda: report_playout(study.score_playout(effort, scheduler), effort), out, json)


@app.command()
def prediction(
    out: FolderOption = Path("out/prediction"),
    json: TablesOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Compare the predictors: error against horizon, and cost, on pulses and recordings.

    Uses all cores; takes about a minute on two. heartpy's example recordings are included if it
    is installed.
    """
    from telepulse.reports.studies import prediction_study as study
    from telepulse.reports.studies.prediction_report import report_prediction

    effort = study.PredictionEffort()
    publish(lambda: report_prediction(study.score_predictors(effort, scheduler), effort), out, json)


@app.command()
def announce(
    out: FolderOption = Path("out/announce"),
    json: TablesOption = None,
    scheduler: SchedulerOption = None,
    records: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder with the records 100, 03700181 and a103l of PhysioNet, such as the sample"
            " data of wfdb; needs telepulse[ecg].",
        ),
    ] = None,
    check: CheckOption = False,
) -> None:
    """Compare prediction with and without an ECG, and find out ECGs that are wrong.

    Uses all cores; takes about ten minutes on two.
    """
    from telepulse.reports.studies import announce_study as study
    from telepulse.reports.studies.announce_report import report_announce

    effort = study.AnnounceEffort()
    publish_checked(
        lambda: report_announce(study.score_announce(effort, records, scheduler), effort),
        out,
        json,
        check,
    )


@app.command()
def cost(
    out: FolderOption = Path("out/cost"),
    json: TablesOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Compare settings by speed and error: tick, predictor, delay, frames and connections.

    Simulates them on all cores; then, as root, runs both nodes as processes over an emulated link,
    and on a host slowed down to a tenth. Takes some fifteen minutes on two cores.
    """
    from telepulse.reports.studies import cost_report, cost_scores

    effort = cost_scores.CostEffort()
    publish(
        lambda: cost_report.report_costs(cost_scores.score_costs(effort, scheduler), effort),
        out,
        json,
    )


@app.command()
def link(
    out: FolderOption = Path("out/link"),
    json: TablesOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Compare buffering and prediction on several links, by the error of the felt force.

    Uses all cores; takes about three minutes on two. heartpy's first example recording is
    included if it is installed.
    """
    from telepulse.reports.studies import link_report, link_scores

    effort = link_scores.LinkEffort()
    publish(
        lambda: link_report.report_links(link_scores.score_links(effort, scheduler), effort),
        out,
        json,
    )
