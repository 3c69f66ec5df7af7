"""Reports: chapters of text, tables and plots, as a folder with a web page, as JSON, as text.

The page needs the extra `report` (matplotlib and Jinja). A plot is one SVG, legible at the width of
a phone; its text and axes take the colour of the reader's theme.
"""

import io
import json
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table as RichTable

from protocol.errors import OutputError
from protocol.host.output import check_writable, escaped, write_whole
from protocol.input_files import shallow
from protocol.provenance import Provenance

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE = "index.html"
# Cells longer than this are taken for words and aligned left in the terminal.
LONGEST_NUMBER = 16
# A plot is 358 px wide on a phone of 390 px; its letters of 11 pt then have 10 px.
PLOT_INCHES = (5.2, 4.0)
# Colours of text and axes on a light and a dark page. Lines have one colour for both.
INK, DARK_INK = "#1d2329", "#e4e8ec"
LINES = ("#2f7fd8", "#d9621c", "#1f9566", "#a35cd0", "#97770f")
THEME = (
    f"<style>:root {{ color: {INK} }}"
    f" @media (prefers-color-scheme: dark) {{ :root {{ color: {DARK_INK} }} }}</style>"
)


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text; the first column names the row.

    If `summary` is given, a terminal shows it in place of the table, which is too long for it.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    note: str = ""
    summary: str = ""

    @classmethod
    def of(
        cls, title: str, rows: Sequence[Mapping[str, str]], note: str = "", summary: str = ""
    ) -> "Table":
        """Return a table of at least one row, each a mapping of the columns to its cells."""
        return cls(title, tuple(rows[0]), [tuple(row.values()) for row in rows], note, summary)


@dataclass(frozen=True, slots=True)
class Plot:
    """A plot: `name` is its file's stem, `draw` fills an empty figure of `PLOT_INCHES`."""

    name: str
    caption: str
    draw: "Callable[[Figure], None]"


@dataclass(frozen=True, slots=True)
class Chapter:
    """A chapter: paragraphs, among which tables and plots may stand, then tables, then plots.

    A chapter without a title opens the page. findings: its results in a sentence each; the page
    lists those of all chapters before the first title. folded: on the page it is closed until it is
    opened. Words between grave accents are shown as code.
    """

    title: str
    paragraphs: "Sequence[str | Table | Plot]" = ()
    tables: Sequence[Table] = ()
    plots: Sequence[Plot] = ()
    findings: Sequence[str] = ()
    folded: bool = False

    @property
    def blocks(self) -> "list[str | Table | Plot]":
        """Paragraphs, tables and plots in their order."""
        return [*self.paragraphs, *self.tables, *self.plots]


@dataclass(frozen=True, slots=True)
class Report:
    """A title, chapters, and the provenance of the figures."""

    title: str
    chapters: Sequence[Chapter]
    provenance: Provenance | None = None

    @property
    def findings(self) -> list[str]:
        """Findings of all chapters, in order."""
        return [finding for chapter in self.chapters for finding in chapter.findings]

    @property
    def made(self) -> str:
        """Version, date and command of the report."""
        if (origin := self.provenance) is None:
            return ""
        date = f"{origin.start_utc[:10]} {origin.start_utc[11:16]} UTC"
        return f"telepulse {origin.version}, {date}: `{shlex.join(origin.command)}`"

    def to_dict(self) -> dict[str, Any]:
        """Return titles, paragraphs and tables as plain types for JSON."""
        made = {} if self.provenance is None else {"provenance": self.provenance.to_dict()}
        return made | {
            "title": self.title,
            "findings": self.findings,
            "chapters": [
                {
                    "title": chapter.title,
                    "paragraphs": [each for each in chapter.blocks if isinstance(each, str)],
                    "tables": [
                        {
                            "title": table.title,
                            "rows": [
                                dict(zip(table.columns, row, strict=True)) for row in table.rows
                            ],
                            "note": table.note,
                        }
                        for table in chapter.blocks
                        if isinstance(table, Table)
                    ],
                }
                for chapter in self.chapters
            ],
        }


_NAMED = re.compile(r"!\[(.+)\]\((\S+)\)", re.DOTALL)


def read_chapters(text: str, named: "Mapping[str, Table | Plot]") -> list[Chapter]:
    """Return the chapters of a Markdown text, in which `##` begins one.

    A quotation is a finding. A paragraph `![words](name)` is the table or plot of that name, with
    the words as its title or caption.
    """
    from markdown_it import MarkdownIt
    from markdown_it.tree import SyntaxTreeNode

    def words(node: SyntaxTreeNode) -> str:
        return " ".join(node.children[0].content.split())

    reader = MarkdownIt("zero").enable(["heading", "blockquote", "table"])
    chapters = [Chapter("")]
    for node in SyntaxTreeNode(reader.parse(text)).children:
        if node.type == "heading":
            chapters.append(Chapter(words(node)))
            continue
        last = chapters[-1]
        if node.type == "blockquote":
            chapters[-1] = replace(last, findings=(*last.findings, words(node.children[0])))
            continue
        block: str | Table | Plot
        if node.type == "table":
            head, *rows = [
                [words(cell) for cell in row.children]
                for part in node.children
                for row in part.children
            ]
            block = Table("", head, rows)
        elif found := _NAMED.fullmatch(block := words(node)):
            block = named[found[2]]
            if isinstance(block, Table):
                block = replace(block, title=found[1])
            else:
                block = replace(block, caption=found[1])
        chapters[-1] = replace(last, paragraphs=(*last.paragraphs, block))
    return chapters


# Names of a provenance's entries for people. The actuator and the controller in effect repeat a
# part of the settings in effect.
ENTRIES = {
    "version": "version of telepulse",
    "commit": "commit",
    "start_utc": "start (UTC)",
    "host": "host",
    "platform": "platform",
    "python": "Python",
    "command": "command",
    "seeds": "random seeds",
    "scene": "scene as written",
    "effective": "settings in effect",
    "actuator": "actuator in effect",
    "gains": "controller in effect",
}
REPEATED = ("actuator", "gains")
# Most entries of a provenance that are shown: a scene of three contactors has 150.
MOST_ROWS = 1_000


def provenance_table(title: str, provenance: Mapping[str, Any]) -> Table:
    """Return a provenance as a table; a terminal shows its main entries only.

    provenance: plain types, or texts of which some hold JSON, as in a recording.
    """
    entries = {key: _plain(value) for key, value in provenance.items()}
    if isinstance(scene := entries.get("scene"), dict):
        entries["scene"] = {**scene, **scene.get("tables", {})}
        entries["scene"].pop("tables", None)
    if "effective" in entries:
        entries = {key: value for key, value in entries.items() if key not in REPEATED}
    if isinstance(start := entries.get("start_utc"), str):
        entries["start_utc"] = f"{start[:10]} {start[11:19]}"
    rows: list[tuple[str, str]] = []
    for key in sorted(entries, key=[*ENTRIES, *entries].index):
        name, value = ENTRIES.get(key, key), entries[key]
        if key == "command" and isinstance(value, list):
            rows.append((name, f"`{shlex.join(map(str, value))}`"))
        elif isinstance(value, dict):
            rows += [(name, ""), *((f"`{inner}`", text) for inner, text in _flattened(value))]
        else:
            rows.append((name, _cell(value)))
    if len(rows) > MOST_ROWS:
        rows[MOST_ROWS:] = [(f"{len(rows) - MOST_ROWS} further entries", "not shown")]
    head = [
        _cell(entries[key]) for key in ("version", "commit", "start_utc", "host") if key in entries
    ]
    return Table(title, ("entry", "value"), rows, summary=", ".join(head))


def _plain(value: Any) -> Any:
    """Return the value of a text that holds JSON of a list or a table; any other as it is."""
    if isinstance(value, str) and value[:1] in ("[", "{"):
        with suppress(ValueError):
            return json.loads(shallow(value))
    return value


def _flattened(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Yield the entries of nested tables, their keys joined by dots as in a scene file."""
    inner: Sequence[tuple[Any, Any]] = ()
    if isinstance(value, dict):
        inner = tuple(value.items())
    elif isinstance(value, list) and any(isinstance(each, dict) for each in value):
        inner = tuple(enumerate(value))
    if not inner:
        yield key, _cell(value)
    for name, each in inner:
        yield from _flattened(each, f"{key}.{name}" if key else str(name))


def _cell(value: Any) -> str:
    if value is None or value in ([], {}):
        return "–"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def text_colour() -> str:
    """Return the text colour of the theme that is being drawn."""
    from matplotlib import rcParams

    return str(rcParams["text.color"])


def check_can_report(folder: Path) -> None:
    """Check, before a report is computed, that it can be written. Raises OutputError."""
    try:
        import jinja2  # noqa: F401
        import matplotlib  # noqa: F401

        folder.mkdir(parents=True, exist_ok=True)
    except ImportError:
        raise OutputError(
            "reports need matplotlib and Jinja: pip install 'telepulse[report]'"
        ) from None
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None
    check_writable(folder / PAGE)


def write_report(report: Report, folder: Path) -> Path:
    """Write the page, its pictures and its JSON into `folder`, and return the page's path.

    The folder has passed `check_can_report`. Raises OutputError.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markdown_it import MarkdownIt
    from markupsafe import Markup

    write_json(report, folder / "report.json")
    if report.provenance is not None:
        made = provenance_table("How this report was made", report.provenance.to_dict())
        last = Chapter("Provenance of this report", tables=(made,), folded=True)
        report = replace(report, chapters=(*report.chapters, last))
    for chapter in report.chapters:
        for block in chapter.blocks:
            if isinstance(block, Plot):
                write_whole(folder / f"{block.name}.svg", draw_svg(block))
    environment = Environment(
        loader=PackageLoader("telepulse", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # Nothing else is markup, since texts hold names and messages from recordings.
    inline = MarkdownIt("zero").enable("backticks").renderInline
    environment.filters["inline"] = lambda text: Markup(inline(text))
    page = folder / PAGE
    write_whole(page, environment.get_template("document.html").render(report=report))
    return page


def write_json(report: Report, path: Path) -> None:
    """Write the report's text and tables as JSON. Raises OutputError."""
    write_whole(path, json.dumps(report.to_dict(), indent=2, ensure_ascii=False) + "\n")


def draw_svg(plot: Plot) -> str:
    """Return a plot as SVG, whose text and axes are dark on a light page, and the reverse."""
    import matplotlib
    from cycler import cycler
    from matplotlib.figure import Figure

    inked = ("axes.edgecolor", "axes.labelcolor", "text.color", "xtick.color", "ytick.color")
    style: Any = dict.fromkeys(inked, INK) | {
        "axes.facecolor": "none",
        "axes.grid": True,
        "axes.prop_cycle": cycler(color=LINES),
        "axes.spines.right": False,
        "axes.spines.top": False,
        "font.size": 11,
        "grid.alpha": 0.2,
        "grid.color": INK,
        "legend.frameon": False,
        "lines.linewidth": 1.8,
        # Text remains text: it can be searched, and the file is small.
        "svg.fonttype": "none",
        "svg.hashsalt": plot.name,
    }
    with matplotlib.rc_context(style):
        figure = Figure(figsize=PLOT_INCHES, layout="constrained")
        plot.draw(figure)
        written = io.StringIO()
        figure.savefig(written, format="svg", transparent=True, metadata={"Date": None})
    drawn = written.getvalue().replace(INK, "currentColor")
    return drawn.replace("<defs>", f"{THEME}<defs>", 1)


def print_tables(report: Report, console: Console) -> None:
    """Print the report's tables and findings; numbers are never cut, however narrow it is."""
    for chapter in report.chapters:
        for table in chapter.blocks:
            if not isinstance(table, Table):
                continue
            if table.summary:
                console.print(escaped(f"{table.title}: {table.summary}"), markup=False)
                continue
            shown = RichTable(
                title=escaped(table.title), title_justify="left", caption=table.note or None
            )
            least = 1
            for position, column in enumerate(table.columns):
                longest = max((len(row[position]) for row in table.rows), default=0)
                numbers = any(map(str.isdigit, "".join(row[position] for row in table.rows)))
                words = position == 0 or longest > LONGEST_NUMBER or not numbers
                # Words may wrap, numbers may not.
                width = min(longest, LONGEST_NUMBER) if words else longest
                width = max(width, *map(len, column.split()), 1)
                shown.add_column(column, justify="left" if words else "right", min_width=width)
                least += width + 3
            for row in table.rows:
                shown.add_row(*map(escaped, row))
            console.print(shown, width=max(console.width, least), crop=False)
    for finding in report.findings:
        console.print(escaped(finding), markup=False, highlight=False)


def percent(share: float, form: str = ".1f") -> str:
    """Return a share in per cent, with a space before the sign as in SI."""
    return f"{100 * share:{form}} %"
