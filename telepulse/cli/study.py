"""`telepulse study`: compute the studies of a person's own data."""

import typer

from telepulse.cli.record_study import record

app = typer.Typer(no_args_is_help=True, help="Studies of the system by computation.")
app.command()(record)


@app.callback()
def main() -> None:
    """Keep the name of the one command, which typer would leave out."""
