"""Rows of a run's summary, for people, and its file of JSON."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

from rich.console import Console
from rich.table import Table
from rich.text import Text

from protocol.config.quantities import count_text
from protocol.histogram import bound
from protocol.host.output import write_whole
from protocol.provenance import Provenance
from protocol.summary.fields import Summary
from protocol.summary.figures import Figure, Surface, figures_on, value_at
from protocol.summary.phrases import COUNT, windows_text

Json = Mapping[str, Any]
# Names for people of the times that shares refer to; others are their keys.
TIMES: Final = {"played": "with a pulse"}


BEFORE: Final = "before the fault"


class RowPart(NamedTuple):
    """A figure in its row: the formatted value, its template, and what a share refers to."""

    figure: Figure
    value: str
    template: str = "{}"
    detail: str = ""

    @property
    def text(self) -> str:
        """The value in its template."""
        return self.template.replace("{}", self.value)


class SummaryRow(NamedTuple):
    """A row of the summary, with the parts that have a value.

    headline: text for a live page. when: time of the figures, unless it is the whole run.
    """

    name: str
    parts: tuple[RowPart, ...]
    headline: str = ""
    when: str = ""

    @property
    def text(self) -> str:
        """All parts in one line."""
        texts = (
            f"{part.figure.separator if number else ''}{part.text}{part.detail}"
            for number, part in enumerate(self.parts)
        )
        return _after(self.when, "".join(texts))

    @property
    def large(self) -> str:
        """Text that a live page shows large."""
        return self.headline or self._lead.text

    @property
    def note(self) -> str:
        """Text that a live page shows below the large one."""
        if self.headline:
            return self.text.replace("\n", "; ")
        others = [f"{p.text}{p.detail}" for p in self.parts if p is not self._lead]
        detail = self._lead.detail.strip()
        note = ", ".join([detail, *others] if detail else others)
        return _after(self.when, note)

    @property
    def _lead(self) -> RowPart:
        return next((part for part in self.parts if part.figure.prominent), self.parts[0])


def _after(when: str, text: str) -> str:
    return ": ".join(filter(None, (when, text)))


def summary_rows(
    summary: Json, surface: Surface, after_fault: bool | None = None
) -> list[SummaryRow]:
    """Return the rows of a summary's JSON on a surface, without rows that have no value.

    after_fault: whether a fault was latched; None: as the summary has it. Then those of the felt
    pulse say that they are of the time before.
    """
    after_fault = bool(summary.get("faults")) if after_fault is None else after_fault
    rows: dict[str, SummaryRow] = {}
    for figure in figures_on(surface):
        if figure.phrase is not None and figure.row in rows:
            continue
        whole = figure.phrase or figure
        parts, headline = tuple(_parts(figure, summary, after_fault)), ""
        if whole.headline is not None and (parts or figure.phrase is not None):
            headline = whole.headline(whole.value(summary) or {})
        if parts or (headline and surface is Surface.PAGE):
            when = BEFORE if after_fault and figure.of_felt else ""
            row = rows.get(figure.row, SummaryRow(figure.row, (), headline, when))
            rows[figure.row] = row._replace(parts=row.parts + parts)
    return list(rows.values())


def cells(summary: Json, surface: Surface) -> dict[str, str]:
    """Return the text of each figure of a surface by its name; empty without a value.

    A count has no noun, since the name has it.
    """
    parts = [part for row in summary_rows(summary, surface) for part in row.parts]
    found = {
        part.figure.name: str(part.figure.value(summary))
        if part.figure.noun
        else f"{part.value}{part.detail}"
        for part in parts
    }
    return {each.name: found.get(each.name, "") for each in figures_on(surface)}


def _parts(figure: Figure, summary: Json, after_fault: bool) -> Iterator[RowPart]:
    """Yield the figure in its row, if it has a value."""
    whole = figure.phrase or figure
    value, detail = whole.value(summary), ""
    if figure.phrase is None and (value is None or (value == 0 and not figure.show_zero)):
        return
    if whole.show is not None:
        shown = whole.show({} if value is None else value)
    elif figure.noun:
        shown = count_text(value, *figure.noun)
    else:
        table, _, name = figure.key.rpartition(".")
        limit = bound(name, value_at(summary, f"{table}.beyond") or ())
        shown = limit + (figure.unit or COUNT).text(value)
    if figure.share_of:
        share = value_at(summary, f"availability.{figure.share_of}")
        of_run = "" if share is None else f" ({100 * share:.1f} % of the run)"
        detail = f" of the time {TIMES.get(figure.share_of, figure.share_of)}{of_run}"
    if shown:
        template = (after_fault and figure.after_fault) or figure.text
        yield RowPart(figure, shown, template if figure.phrase is None else "{}", detail)


def row_texts(summary: Json, surface: Surface) -> list[tuple[str, str]]:
    """Return name and text of each row of a summary's JSON on a surface.

    The rows of several contactors come last, with a line for each. Those of the samples follow the
    display's own.
    """
    found = [(row.name, row.text) for row in summary_rows(summary, surface)]
    contactors, after_fault = summary.get("contactors", {}), bool(summary.get("faults"))
    lines: dict[str, list[str]] = {}
    for name, figures in contactors.items():
        # One line for all contactors, below.
        alone = {**figures, "windows": []}
        for row in summary_rows(alone, surface, after_fault):
            lines.setdefault(row.name, []).append(f"{name}: {row.text}")
    found = [(name, "\n".join([text, *lines.pop(name, [])])) for name, text in found]
    found += [(name, "\n".join(texts)) for name, texts in lines.items()]
    windows = [figures.get("windows", []) for figures in contactors.values()]
    by_time = windows_text(windows) if surface is Surface.SUMMARY and windows else None
    return [*found, ("by time", by_time)] if by_time else found


def print_summary(summary: Summary, console: Console) -> None:
    """Print the summary for people, one line for each row that has a value."""
    lines = Table(show_header=False, box=None, pad_edge=False)
    for name, text in row_texts(summary.to_dict(), Surface.SUMMARY):
        # As Text, because rich would take a [section] in a fault for markup.
        lines.add_row(name, Text(text))
    console.print(lines)


def write_json(summary: Summary, path: Path, provenance: Provenance | None = None) -> None:
    """Write the summary as JSON, together with its provenance. Raises OutputError."""
    origin = {} if provenance is None else {"provenance": provenance.to_dict()}
    write_whole(path, json.dumps(summary.to_dict() | origin, indent=2) + "\n")
