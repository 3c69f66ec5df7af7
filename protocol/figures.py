"""Figures of the summary, each described once: meaning, unit, display text, metric.

The fields are in `protocol/run_summary.py` and, for the members of a table, in `summary_tables.py`
and `loop_tables.py`; `figure` and `table` make them. Terminal, live page, Prometheus, the report of
a recording and the reference read the same fields, so a new figure is one new field. `absent` lists
each surface that omits the figure, with the reason.
"""

import dataclasses
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, NamedTuple, get_type_hints

from protocol.config.quantities import count_text
from protocol.histogram import bound


class Surface(StrEnum):
    """A place where people or programs read the figures, besides the JSON."""

    SUMMARY = "summary printed at the end"
    PAGE = "live page"
    REPORT = "report of a recording"
    METRICS = "metrics"


class Unit(NamedTuple):
    """Unit of a figure: its name in JSON, and the name and the format of a number in a text.

    factor: multiplies the JSON's value for the text. base: multiplies it for Prometheus.
    """

    name: str
    shown: str
    form: str
    factor: float = 1.0
    base: float = 1.0

    def text(self, value: float | None) -> str:
        """Return a value with its unit; empty without a value. One that rounds to 0 has no sign."""
        if value is None:
            return ""
        number = f"{value * self.factor:z{self.form}}" if self.form else f"{value}"
        return f"{number} {self.shown}".rstrip()


COUNT = Unit("", "", "")
SECONDS = Unit("s", "s", ".2f")
MILLISECONDS = Unit("ms", "ms", ".2f", base=1e-3)
MICROSECONDS = Unit("µs", "µs", ".0f", base=1e-6)
PPM = Unit("ppm", "ppm", ".1f", base=1e-6)
NEWTONS = Unit("N", "mN", ".3f", factor=1e3)
STRAIN = Unit("strain", "", ".3e")
SHARE = Unit("share, 0 to 1", "%", ".1f", factor=100.0)
RATIO = Unit("ratio", "", ".2f")


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the summary, or the defaults for all figures of a table."""

    meaning: str = ""  # for the reference, and for Prometheus unless `help` is given
    text: str = "{}"  # template in a row; "{}" is the value
    unit: Unit | None = None  # None takes the table's; without one it is a count
    row: str = ""  # name of the row; empty takes the table's
    title: str = ""  # name beside its row, if the value is within the words of the text
    separator: str = ", "  # text before this figure, unless it is the first of its row
    noun: tuple[str, ...] = ()  # singular and plural of the noun after a count
    show_zero: bool = True  # a value of 0 is shown
    share_of: str = ""  # for a share: key in `availability` of the time that is 100 %
    prominent: bool = False  # a live page shows it large, instead of the first one of its row
    # Formats a value that is no number, or a whole table as one phrase; returns None to hide it.
    show: Callable[[Any], str | None] | None = None
    headline: Callable[[Any], str] | None = None  # returns the large text of a live page
    metric: str = ""  # name for Prometheus without prefix and suffix; empty takes the table's
    counter: bool = False  # else a gauge, or a summary if labelled with a quantile
    labels: Mapping[str, str] = field(default_factory=dict)
    label: str = ""  # name of the label for the keys of a map or the items of a list
    help: str = ""
    # Surfaces that omit the figure, each with the reason.
    absent: Mapping[Surface, str] = field(default_factory=dict)
    # Set by `figures_of`: the keys in the JSON, joined by dots; the field's type; the table's
    # figure, if the table is shown as one phrase.
    key: str = ""
    type: Any = None
    phrase: "Figure | None" = None

    @property
    def metric_type(self) -> str:
        """Prometheus type of the metric."""
        return "summary" if "quantile" in self.labels else "counter" if self.counter else "gauge"

    @property
    def name(self) -> str:
        """Name outside its row: row and text, or the row alone if it is one phrase."""
        words = self.title or self.text.replace("{}", self.noun[-1] if self.noun else "").strip()
        return f"{self.row}, {words}" if words and self.phrase is None else self.row

    def value(self, summary: Mapping[str, Any]) -> Any:
        """Return the figure's value in a summary's JSON; None without one."""
        return _value_at(summary, self.key)


_METRIC = re.compile(r"(?P<name>\w*?)(?P<counter>_total)?(?:\{(?P<labels>.*)\})?")


def figure(
    meaning: str,
    text: str = "{}",
    unit: Unit | None = None,
    metric: str = "",
    factory: Callable[[], Any] = lambda: None,
    **arguments: Any,
) -> Any:
    """Return the field of a figure, with the arguments of `Figure`.

    metric: name and labels as Prometheus writes them, such as 'samples_total{outcome="played"}',
    where "_total" makes a counter. factory: returns the initial value, by default None.
    """
    match = _METRIC.fullmatch(metric)
    assert match is not None
    labels = dict(re.findall(r'(\w+)="([^"]*)"', match["labels"] or ""))
    arguments |= {"metric": match["name"], "counter": match["counter"] is not None}
    described = Figure(meaning, text, unit, labels=labels, **arguments)
    return field(default_factory=factory, metadata={"figure": described})


def table(
    kind: type, row: str = "", unit: Unit | None = None, metric: str = "", **arguments: Any
) -> Any:
    """Return the field of a dataclass of figures; the arguments apply to all of them."""
    return figure("", unit=unit, metric=metric, factory=kind, row=row, **arguments)


def figures_of(kind: type, shared: Figure = Figure(), prefix: str = "") -> Iterator[Figure]:
    """Yield the figures of a dataclass and of its tables, with settings inherited from the table.

    Raises TypeError for a field without a figure.
    """
    hints = get_type_hints(kind)
    for each in dataclasses.fields(kind):
        note, value = each.metadata.get("figure"), hints[each.name]
        if note is None:
            raise TypeError(f"{kind.__name__}.{each.name} has no Figure")
        completed = replace(
            note,
            key=prefix + each.name,
            type=value,
            row=note.row or (shared.phrase or shared).row,
            unit=note.unit or shared.unit,
            metric=note.metric or shared.metric,
            labels={**shared.labels, **note.labels},
            absent={**shared.absent, **note.absent},
            phrase=shared.phrase,
        )
        if isinstance(value, type) and dataclasses.is_dataclass(value):
            phrase = shared.phrase if note.show is None else completed
            yield from figures_of(value, replace(completed, phrase=phrase), f"{prefix}{each.name}.")
        else:
            yield completed


def _value_at(summary: Any, key: str) -> Any:
    for name in key.split("."):
        summary = summary.get(name) if isinstance(summary, Mapping) else None
    return summary


class RowPart(NamedTuple):
    """A figure in its row: the formatted value, and what a share refers to."""

    figure: Figure
    value: str
    detail: str = ""

    @property
    def text(self) -> str:
        """The value in its template."""
        return (self.figure.text if self.figure.phrase is None else "{}").replace("{}", self.value)


class SummaryRow(NamedTuple):
    """A row of the summary, with the parts that have a value; headline: text for a live page."""

    name: str
    parts: tuple[RowPart, ...]
    headline: str = ""

    @property
    def text(self) -> str:
        """All parts in one line."""
        joined = (f"{part.figure.separator}{part.text}{part.detail}" for part in self.parts)
        return "".join(joined).removeprefix(self.parts[0].figure.separator if self.parts else "")

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
        return ", ".join([detail, *others] if detail else others)

    @property
    def _lead(self) -> RowPart:
        return next((part for part in self.parts if part.figure.prominent), self.parts[0])


class Registry:
    """The figures of a summary's dataclass, and its rows for people."""

    def __init__(self, summary: type) -> None:
        self.figures = tuple(figures_of(summary))

    def on(self, surface: Surface) -> Iterator[Figure]:
        """Yield the figures of a surface."""
        yield from (figure for figure in self.figures if surface not in figure.absent)

    def rows(self, summary: Mapping[str, Any], surface: Surface) -> list[SummaryRow]:
        """Return the rows of a summary's JSON on a surface, without rows that have no value."""
        rows: dict[str, SummaryRow] = {}
        for figure in self.on(surface):
            if figure.phrase is not None and figure.row in rows:
                continue
            whole = figure.phrase or figure
            parts, headline = _parts(figure, summary), ""
            if whole.headline is not None and (parts or figure.phrase is not None):
                headline = whole.headline(whole.value(summary) or {})
            if parts or (headline and surface is Surface.PAGE):
                row = rows.get(figure.row, SummaryRow(figure.row, (), headline))
                rows[figure.row] = row._replace(parts=row.parts + parts)
        return list(rows.values())

    def cells(self, summary: Mapping[str, Any], surface: Surface) -> dict[str, str]:
        """Return the text of each figure of a surface by its name; empty without a value.

        A count has no noun, since the name has it.
        """
        parts = [part for row in self.rows(summary, surface) for part in row.parts]
        found = {
            part.figure.name: str(part.figure.value(summary))
            if part.figure.noun
            else f"{part.value}{part.detail}"
            for part in parts
        }
        return {each.name: found.get(each.name, "") for each in self.on(surface)}


# Names for people of the times that shares refer to; others are their keys.
_TIMES = {"played": "with a pulse"}


def _parts(figure: Figure, summary: Mapping[str, Any]) -> tuple[RowPart, ...]:
    whole = figure.phrase or figure
    value, detail = whole.value(summary), ""
    if figure.phrase is None and (value is None or (value == 0 and not figure.show_zero)):
        return ()
    if whole.show is not None:
        shown = whole.show({} if value is None else value)
    elif figure.noun:
        shown = count_text(value, *figure.noun)
    else:
        table, _, name = figure.key.rpartition(".")
        limit = bound(name, _value_at(summary, f"{table}.beyond") or ())
        shown = limit + (figure.unit or COUNT).text(value)
    if figure.share_of:
        share = _value_at(summary, f"availability.{figure.share_of}")
        of_run = "" if share is None else f" ({100 * share:.1f} % of the run)"
        detail = f" of the time {_TIMES.get(figure.share_of, figure.share_of)}{of_run}"
    return (RowPart(figure, shown, detail),) if shown else ()


def absent(reason: str, *surfaces: Surface, but: Surface | None = None) -> dict[Surface, str]:
    """Return `Figure.absent`: absence from some surfaces, or all `but` one, with the reason."""
    return {each: reason for each in surfaces or Surface if each != but}


def texts(values: Iterable[str], between: str = ", ") -> str | None:
    """Join texts into one line; return None without any."""
    return between.join(values) or None
