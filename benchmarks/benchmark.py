"""One run of a benchmark: its effort, and where its tables and verdicts go."""

import inspect
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple, TypeVar

import rich.box
from rich.console import Console, JustifyMethod
from rich.table import Table as RichTable
from rich.text import Text

from benchmarks.criteria import CRITERIA, Criterion
from telepulse.parallel import sweep

Case = TypeVar("Case")
Result = TypeVar("Result")
FILE_WIDTH = 200


class Table(NamedTuple):
    """A table of text; its first column names the row."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""

    def markdown(self) -> str:
        """Return the table as a page of the documentation has it."""
        lines = [self.columns, ["---"] * len(self.columns), *self.rows]
        cells = [
            "| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in lines
        ]
        return "\n\n".join(filter(None, (f"**{self.title}**", "\n".join(cells), self.note)))


@dataclass
class Benchmark:
    """Settings of one run of a benchmark, and the place where its tables and verdicts go.

    Parameters
    ----------
    name
        Name of the benchmark; its criteria are `benchmarks.criteria.CRITERIA[name]`.
    quick
        The least effort that still runs every part: a check that the benchmark works. Its figures
        mean nothing, and are not judged.
    cases
        Texts that choose cases by their names, where a benchmark has some; none for all.
    seeds
        Number of seeds, where a benchmark repeats its runs with several; None for its own.
    scheduler
        Address of a Dask scheduler such as `tcp://HOST:8786`; without one, this machine's cores.
    records
        Folder of recordings that a benchmark compares besides; None for none.
    """

    name: str
    quick: bool = False
    cases: tuple[str, ...] = ()
    seeds: int | None = None
    scheduler: str | None = None
    records: Path | None = None
    tables: list[Table] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)

    def table(
        self, title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], note: str = ""
    ) -> None:
        """Print a table, and keep it for the page."""
        self._show(Table(title, columns, list(rows), note))

    def choose(self, names: Iterable[str]) -> list[str]:
        """Return the names of cases to run. Raises ValueError where a text chooses none."""
        known = list(names)
        for text in self.cases:
            if not any(text in name for name in known):
                raise ValueError(f"no case {text!r}; known: {', '.join(known)}")
        return [name for name in known if not self.cases or any(t in name for t in self.cases)]

    def run_parts(self, parts: "Mapping[str, Callable[[Benchmark], None]]") -> None:
        """Run the chosen parts of a benchmark, by the names of its cases."""
        for name in self.choose(parts):
            parts[name](self)

    def judge(self, name: str, figure: float) -> None:
        """Judge a figure by the criterion of this name. Raises KeyError without one."""
        criteria = {criterion.name for criterion in CRITERIA[self.name]}
        if name not in criteria:
            raise KeyError(f"{self.name} has no criterion {name!r}")
        self.figures[name] = figure

    def run(self, function: Callable[[Case], Result], cases: Iterable[Case]) -> list[Result]:
        """Return a module-level function's result for each case, computed on all cores."""
        return sweep(function, cases, self.scheduler)

    def close(self) -> bool:
        """Print the verdicts; return whether no criterion is missed."""
        criteria = CRITERIA.get(self.name, ())
        if self.quick or not criteria:
            return True
        rows = [_verdict(criterion, self.figures.get(criterion.name)) for criterion in criteria]
        met = sum(row[-1] == "holds" for row in rows)
        self._show(
            Table(
                f"{met} of {len(rows)} criteria hold", ("criterion", "bound", "", "verdict"), rows
            )
        )
        return all(row[-1] != "falls short" for row in rows)

    def _show(self, table: Table) -> None:
        self.tables.append(table)
        shown = RichTable(box=rich.box.SIMPLE_HEAD)
        for position, column in enumerate(table.columns):
            justify: JustifyMethod = "left" if position == 0 else "right"
            shown.add_column(column, justify=justify, overflow="fold")
        for row in table.rows:
            shown.add_row(*row)
        # In a file no line is folded.
        console = Console(width=None if sys.stdout.isatty() else FILE_WIDTH)
        console.print(Text(table.title, style="bold"), shown, *filter(None, [table.note]))


def _verdict(criterion: Criterion, figure: float | None) -> tuple[str, str, str, str]:
    """Return the row of a criterion; a figure that is not a number holds nothing."""
    if figure is None:
        return criterion.name, criterion.bound, "–", "not measured"
    verdict = "holds" if criterion.holds(figure) else "falls short"
    return criterion.name, criterion.bound, criterion.shown(figure), verdict


def write_tables(path: Path, name: str, tables: Sequence[Table]) -> None:
    """Replace the tables between the two marks of a benchmark in a page.

    Raises ValueError if the page has not both marks, `<!-- bench NAME -->` and `<!-- end NAME -->`,
    and OSError if it cannot be read or written.
    """
    begin, end = f"<!-- bench {name} -->\n", f"<!-- end {name} -->"
    text = path.read_text(encoding="utf-8")
    if not 0 <= text.find(begin) < text.find(end):
        raise ValueError(f"{path}: has no lines {begin.strip()!r} and {end!r} in this order")
    before, rest = text.split(begin, 1)
    after = rest.split(end, 1)[1]
    inner = "\n\n".join(table.markdown() for table in tables)
    path.write_text(f"{before}{begin}\n{inner}\n\n{end}{after}", encoding="utf-8")


def first_line(docstring: str | None) -> str:
    """Return what a benchmark answers: its docstring's first paragraph, on one line."""
    return " ".join(inspect.cleandoc(docstring or "").split("\n\n", 1)[0].split())
