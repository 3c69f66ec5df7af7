"""Reports: chapters of text, tables and plots, as a folder with a web page, as JSON, as text.

The page needs the extra `report` (matplotlib and Jinja). Every plot is drawn light and dark,
wide and narrow, and the browser shows the one of its theme and width.
"""

import json
import re
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table as RichTable

from protocol.errors import OutputError
from protocol.host.output import write_whole
from protocol.provenance import Provenance
from telepulse.reports.notation import typeset
from telepulse.reports.pictures import SIZES, THEMES, draw_picture

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

PAGE = "index.html"
# Cells longer than this are taken for words and aligned left in the terminal.
LONGEST_NUMBER = 16


@dataclass(frozen=True, slots=True)
class Table:
    """A table of text; the first column names the row.

    Numbers are plain (1e-9); `telepulse.reports.notation` sets them for the page. If `summary` is
    given, a terminal shows it in place of the table, which is too long for it.
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
    """A plot: `name` is its file's stem, `draw` fills an empty figure."""

    name: str
    caption: str
    draw: "Callable[[Figure], None]"


@dataclass(frozen=True, slots=True)
class Chapter:
    """A chapter: paragraphs, then tables, then plots.

    findings: its results in a sentence each; the report begins with those of all chapters. folded:
    on the page it is closed until it is opened. Words between grave accents are shown as code.
    """

    title: str
    paragraphs: Sequence[str] = ()
    tables: Sequence[Table] = ()
    plots: Sequence[Plot] = ()
    findings: Sequence[str] = ()
    folded: bool = False


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
                    "paragraphs": list(chapter.paragraphs),
                    "tables": [
                        {
                            "title": table.title,
                            "rows": [
                                dict(zip(table.columns, row, strict=True)) for row in table.rows
                            ],
                            "note": table.note,
                        }
                        for table in chapter.tables
                    ],
                }
                for chapter in self.chapters
            ],
        }


# Names of a provenance's entries for people. The actuator and the controller in effect repeat a
# part of the settings in effect.
ENTRIES = {
    "version": "version of telepulse",
    "build": "build",
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
    if start := entries.get("start_utc"):
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
    head = [
        str(entries[key]) for key in ("version", "commit", "start_utc", "host") if key in entries
    ]
    return Table(title, ("entry", "value"), rows, summary=", ".join(head))


def _plain(value: Any) -> Any:
    """Return the value of a text that holds JSON of a list or a table; any other as it is."""
    if isinstance(value, str) and value[:1] in ("[", "{"):
        try:
            return json.loads(value)
        except ValueError:
            return value
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


# Markers and dashes, by which lines that overlap can be distinguished.
STYLES = ("o-", "s--", "^-", "v--", "P-", "x:", "D-", "*-")


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
        page = folder / PAGE
        was_there = page.exists()
        page.open("ab").close()
        if not was_there:
            page.unlink()
    except ImportError:
        raise OutputError(
            "reports need matplotlib and Jinja: pip install 'telepulse[report]'"
        ) from None
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from None


def write_report(report: Report, folder: Path) -> Path:
    """Write the page, its pictures and its JSON into `folder`, and return the page's path.

    The folder has passed `check_can_report`. Raises OutputError.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    write_json(report, folder / "report.json")
    if report.provenance is not None:
        made = provenance_table("How this report was made", report.provenance.to_dict())
        last = Chapter("Provenance of this report", tables=(made,), folded=True)
        report = replace(report, chapters=(*report.chapters, last))
    for chapter in report.chapters:
        for plot in chapter.plots:
            for theme, size in product(THEMES, SIZES):
                path = folder / f"{plot.name}{size.suffix}-{theme.name}.png"
                draw_picture(plot.draw, theme, size, path)
    environment = Environment(
        loader=PackageLoader("telepulse", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["code"] = _code
    page = folder / PAGE
    write_whole(page, environment.get_template("document.html").render(report=report, sizes=SIZES))
    return page


def write_json(report: Report, path: Path) -> None:
    """Write the report's text and tables as JSON. Raises OutputError."""
    write_whole(path, json.dumps(report.to_dict(), indent=2, ensure_ascii=False) + "\n")


def _code(text: str) -> "Markup":
    """Return a text as HTML, typeset, with the words between grave accents as code."""
    from markupsafe import Markup, escape

    # Every second part was between grave accents.
    parts = re.split(r"`([^`]+)`", text)
    parts[::2] = [str(escape(typeset(part))) for part in parts[::2]]
    parts[1::2] = [f"<code>{escape(part)}</code>" for part in parts[1::2]]
    return Markup("".join(parts))


def print_tables(report: Report, console: Console) -> None:
    """Print the report's tables and findings; numbers are never cut, however narrow it is."""
    for chapter in report.chapters:
        for table in chapter.tables:
            if table.summary:
                console.print(f"{table.title}: {table.summary}", markup=False)
                continue
            shown = RichTable(title=table.title, title_justify="left", caption=table.note or None)
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
                shown.add_row(*row)
            console.print(shown, width=max(console.width, least), crop=False)
    for finding in report.findings:
        console.print(finding, markup=False, highlight=False)
