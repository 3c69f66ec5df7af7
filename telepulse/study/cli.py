"""`telepulse study`: one command a study."""

from pathlib import Path
from typing import Annotated

import typer

from protocol.commands import one_line_errors, plain_console
from protocol.summary import check_writable
from telepulse.report import check_can_report, print_tables, write_json, write_report

PROGRAM = "telepulse"
app = typer.Typer(no_args_is_help=True, help="Questions about the system, answered by computing.")

ReportOption = Annotated[Path, typer.Option(metavar="FOLDER", help="Write the report here.")]
JsonOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Write the tables here as JSON.")
]


@app.command()
def integrators(out: ReportOption = Path("out/integrators"), json: JsonOption = None) -> None:
    """Speed against error of the ways to integrate the paper's actuator in its loop.

    Takes about half a minute. python-control takes part where it is installed.
    """
    # The study brings matplotlib's and scipy's import times; other commands do without.
    from telepulse.study.integrator_scores import Effort, score_integrators
    from telepulse.study.integrators_report import report_integrators
    from telepulse.study.one_thread import in_one_thread

    console = plain_console()
    with one_line_errors(PROGRAM):
        check_writable(json)
        check_can_report(out)
        effort = Effort()
        report = report_integrators(in_one_thread(score_integrators, effort), effort)
        page = write_report(report, out)
        print_tables(report, console)
        if json is not None:
            write_json(report, json)
    console.print(f"report: {page}")


@app.command()
def playout(out: ReportOption = Path("out/playout"), json: JsonOption = None) -> None:
    """Delay against late frames of the ways to set the playout delay, and what is best possible.

    Uses all cores; takes about a minute on two.
    """
    from telepulse.study import playout_scores
    from telepulse.study.playout_report import CURVES, report_playout

    console = plain_console()
    with one_line_errors(PROGRAM):
        check_writable(json)
        check_can_report(out)
        effort = playout_scores.Effort(curves=CURVES)
        report = report_playout(playout_scores.score_playout(effort), effort)
        page = write_report(report, out)
        print_tables(report, console)
        if json is not None:
            write_json(report, json)
    console.print(f"report: {page}")


@app.command()
def prediction(out: ReportOption = Path("out/prediction"), json: JsonOption = None) -> None:
    """Error against horizon and cost of the predictors, on pulses and recordings.

    Uses all cores; takes about a minute on two. Recordings take part where heartpy is installed.
    """
    from telepulse.study import one_thread
    from telepulse.study.prediction_report import report_prediction
    from telepulse.study.prediction_scores import Effort, score_predictors

    console = plain_console()
    with one_line_errors(PROGRAM):
        check_writable(json)
        check_can_report(out)
        effort = Effort()
        report = report_prediction(one_thread.in_one_thread(score_predictors, effort), effort)
        page = write_report(report, out)
        print_tables(report, console)
        if json is not None:
            write_json(report, json)
    console.print(f"report: {page}")
