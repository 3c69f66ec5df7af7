"""`python -m benchmarks [NAME ...]`: run the named benchmarks; without a name, list them."""

import ast
import importlib
import pkgutil
from pathlib import Path
from typing import Annotated

import typer

import benchmarks
from benchmarks.benchmark import Benchmark, first_line, write_tables
from protocol.errors import TelepulseError

# What the benchmarks share.
SHARED = {"__main__", "benchmark", "criteria", "nodes", "timing"}


def questions() -> dict[str, str]:
    """Return the names of the benchmarks, and what each answers."""
    found = {}
    for module in pkgutil.iter_modules(benchmarks.__path__):
        if module.name not in SHARED:
            path = Path(benchmarks.__path__[0], module.name)
            source = path / "__init__.py" if module.ispkg else path.with_suffix(".py")
            tree = ast.parse(source.read_text(encoding="utf-8"))
            found[module.name] = first_line(ast.get_docstring(tree))
    return found


def main(
    names: Annotated[list[str] | None, typer.Argument(metavar="[NAME ...]")] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Try every part with little effort; judge nothing.")
    ] = False,
    case: Annotated[
        list[str] | None,
        typer.Option(metavar="TEXT", help="Run only the cases whose name has this text."),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Number of seeds."),
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Compute on the Dask cluster of this scheduler."),
    ] = None,
    records: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Folder of recordings to compare besides.")
    ] = None,
    write: Annotated[
        Path | None,
        typer.Option(metavar="PAGE", help="Replace the tables between the marks of this page."),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="End with exit status 1 where a criterion is missed.")
    ] = False,
) -> None:
    """Run the named benchmarks; without a name, list what each of them answers."""
    known = questions()
    if not names:
        for name, question in known.items():
            print(f"{name}: {question}")
        return
    for name in names:
        if name not in known:
            raise typer.BadParameter(f"no benchmark {name!r}; known: {', '.join(known)}")
    holds = True
    for name in names:
        run = Benchmark(name, quick, tuple(case or ()), seeds, scheduler, records)
        try:
            importlib.import_module(f"benchmarks.{name}").main(run)
            holds &= run.close()
            if write is not None:
                write_tables(write, name, run.tables)
        except (TelepulseError, OSError, ValueError) as error:
            raise SystemExit(f"benchmarks: {name}: {error}") from error
    if check and not holds:
        raise typer.Exit(1)


if __name__ == "__main__":
    typer.run(main)
