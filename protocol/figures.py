"""Figures of the summary, each described once: meaning, unit, words for people, metric.

A field of the summary's dataclasses carries its `Figure` (made by `figure`); a field that holds a
table of figures carries a `Row` (made by `table`). Terminal, live page, Prometheus, the report of
a recording and the reference draw from these, so a new figure is one new field. A surface that
leaves a figure out stands in `absent` with the reason.
"""

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, NamedTuple, get_type_hints

from protocol.config.quantities import count_text
from protocol.histogram import bound


class Surface(StrEnum):
    """Where people and programs read the figures, besides the JSON."""

    SUMMARY = "summary printed at the end"
    TERMINAL = "live view in the terminal"
    PAGE = "live page"
    REPORT = "report of a recording"
    METRICS = "metrics"


@dataclass(frozen=True, slots=True)
class Unit:
    """Unit of a figure in JSON, and how people and Prometheus get it.

    Attributes
    ----------
    name, shown : str
        Unit in JSON, and in a text.
    form : str
        Format of the number in a text.
    factor, base : float
        From the JSON's unit to the shown one, and to Prometheus's base unit.
    """

    name: str
    shown: str
    form: str
    factor: float = 1.0
    base: float = 1.0

    def text(self, value: float | None, form: str = "") -> str:
        """Return a value with its unit; empty without a value."""
        if value is None:
            return ""
        number = f"{value * self.factor:{form or self.form}}" if self.form else f"{value}"
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
    """A figure of the summary.

    Attributes
    ----------
    meaning : str
        What it is, for the reference and for Prometheus.
    text : str
        Its words in a row, "{}" for the value.
    unit : Unit or None
        None: the unit of its `Row`, else a count.
    form : str
        Format that replaces the unit's.
    row : str
        Row of a figure that does not stand in its table's.
    joint : str
        What stands between it and the part before it in the row.
    noun : tuple of str
        Noun of a count, in the singular and the plural.
    zero : bool
        Whether a 0 is shown.
    of : str
        Key of the share of the run that this is a share of.
    lead : bool
        Whether a live page shows it large, before the first figure of its row.
    show : callable or None
        Returns the text of a value that is no number; None where it is not shown.
    headline : callable or None
        Returns what a live page shows large of a value that is no number.
    metric : str
        Name of its metric without the prefix; else its `Row` names it.
    counter : bool
        Whether the metric is a counter; else it is a gauge, or a quantile by its label `quantile`.
    labels : mapping
        Labels of the metric, which tell figures of one name apart.
    label : str
        Label for the names in a map of counts, or for the texts of a list.
    help : str
        Help text of the metric; empty for `meaning`.
    absent : mapping
        Surfaces without the figure, each with the reason.
    key, type, phrase
        Filled in by `figures_of`: its keys in the JSON, joined by dots; its type; key and row of
        its table where that is shown as one phrase.
    """

    meaning: str
    text: str = "{}"
    unit: Unit | None = None
    form: str = ""
    row: str = ""
    joint: str = ", "
    noun: tuple[str, ...] = ()
    zero: bool = True
    of: str = ""
    lead: bool = False
    show: Callable[[Any], str | None] | None = None
    headline: Callable[[Any], str] | None = None
    metric: str = ""
    counter: bool = False
    labels: Mapping[str, str] = field(default_factory=dict)
    label: str = ""
    help: str = ""
    absent: Mapping[Surface, str] = field(default_factory=dict)
    key: str = ""
    type: Any = None
    phrase: tuple[str, "Row"] | None = None

    @property
    def kind(self) -> str:
        """Prometheus's kind of its metric."""
        return "summary" if "quantile" in self.labels else "counter" if self.counter else "gauge"

    @property
    def name(self) -> str:
        """Its name where it stands alone: row and words, or the row that is one phrase."""
        words = self.text.replace("{}", self.noun[-1] if self.noun else "").strip()
        return f"{self.row}, {words}" if words and self.phrase is None else self.row

    def value(self, summary: Mapping[str, Any]) -> Any:
        """Return its value in a summary's JSON; None where there is none."""
        return value_at(summary, self.key)

    def shown(self, summary: Mapping[str, Any]) -> str | None:
        """Return its value as a text; None where there is none to show."""
        value = self.value(summary)
        if value is None or (value == 0 and not self.zero):
            return None
        if self.show is not None:
            return self.show(value)
        if self.noun:
            return count_text(value, *self.noun)
        table, _, name = self.key.rpartition(".")
        limit = bound(name, value_at(summary, f"{table}.beyond") or ())
        return f"{limit}{(self.unit or COUNT).text(value, self.form)}"


@dataclass(frozen=True, slots=True)
class Row:
    """A row of figures: what those of one table share.

    Attributes
    ----------
    name : str
        Name of the row for people; empty where each figure has its own.
    unit, metric, labels, absent
        As of `Figure`, for all figures of the table.
    show, headline : callable or None
        As of `Figure`, of the whole table: one phrase in place of the figures' texts.
    """

    name: str = ""
    unit: Unit | None = None
    metric: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    show: Callable[[Mapping[str, Any]], str | None] | None = None
    headline: Callable[[Mapping[str, Any]], str] | None = None
    absent: Mapping[Surface, str] = field(default_factory=dict)


def figure(
    meaning: str, *args: Any, factory: Callable[[], Any] | None = None, **kwargs: Any
) -> Any:
    """Return the field of a figure, with the arguments of `Figure`; None stands for no value.

    Parameters
    ----------
    factory : callable or None
        Returns the value of a figure that is a list or map.
    """
    metadata = {"figure": Figure(meaning, *args, **kwargs)}
    if factory is not None:
        return field(default_factory=factory, metadata=metadata)
    return field(default=None, metadata=metadata)


def table(kind: type, *args: Any, **kwargs: Any) -> Any:
    """Return the field of a table of figures, a dataclass, with the arguments of `Row`."""
    return field(default_factory=kind, metadata={"figure": Row(*args, **kwargs)})


def figures_of(
    kind: type, row: Row = Row(), prefix: str = "", phrase: tuple[str, Row] | None = None
) -> Iterator[Figure]:
    """Yield the figures of a dataclass and of the tables in it, completed from their rows.

    Raises
    ------
    TypeError
        A field has no figure.
    """
    for name, (value, note) in described_fields(kind).items():
        key = prefix + name
        if dataclasses.is_dataclass(value):
            assert isinstance(value, type)
            inner = note if isinstance(note, Row) else Row()
            merged = replace(
                inner,
                name=inner.name or row.name,
                unit=inner.unit or row.unit,
                metric=inner.metric or row.metric,
                labels={**row.labels, **inner.labels},
                absent={**row.absent, **inner.absent},
            )
            shown = (key, inner) if inner.show is not None else phrase
            yield from figures_of(value, merged, f"{key}.", shown)
        elif isinstance(note, Figure):
            yield replace(
                note,
                key=key,
                type=value,
                row=note.row or (phrase[1].name if phrase else row.name),
                unit=note.unit or row.unit,
                metric=note.metric or row.metric,
                labels={**row.labels, **note.labels},
                absent={**row.absent, **note.absent},
                phrase=phrase,
            )
        else:
            raise TypeError(f"{kind.__name__}.{name} has no Figure")


def described_fields(kind: type) -> dict[str, tuple[Any, Any]]:
    """Return type and `Figure` or `Row` (None without one) of each field of a dataclass."""
    hints = get_type_hints(kind)
    return {
        each.name: (hints[each.name], each.metadata.get("figure"))
        for each in dataclasses.fields(kind)
    }


def value_at(summary: Any, key: str) -> Any:
    """Return what stands at keys joined by dots; None where one of them is missing."""
    for name in key.split("."):
        summary = summary.get(name) if isinstance(summary, Mapping) else None
    return summary


class RowPart(NamedTuple):
    """A figure in its row: its value, with its words in `text`; detail: what it is a share of."""

    name: str
    joint: str
    value: str
    text: str
    detail: str = ""
    lead: bool = False


class SummaryRow(NamedTuple):
    """A row for people, with the parts that have a value; headline: in short, for a live page."""

    name: str
    parts: tuple[RowPart, ...]
    headline: str = ""

    @property
    def text(self) -> str:
        """All parts in one line."""
        joined = (f"{part.joint}{part.text}{part.detail}" for part in self.parts)
        return "".join(joined).removeprefix(self.parts[0].joint if self.parts else "")

    @property
    def large(self) -> str:
        """What a live page shows large."""
        return self.headline or self._lead.text

    @property
    def note(self) -> str:
        """What a live page shows beneath."""
        if self.headline:
            return self.text.replace("\n", "; ")
        others = [f"{p.text}{p.detail}" for p in self.parts if p is not self._lead]
        detail = self._lead.detail.strip()
        return ", ".join([detail, *others] if detail else others)

    @property
    def _lead(self) -> RowPart:
        return next((part for part in self.parts if part.lead), self.parts[0])


class Registry:
    """The figures of a summary's dataclass, and its rows for people."""

    def __init__(self, summary: type) -> None:
        self.figures = tuple(figures_of(summary))

    def on(self, surface: Surface) -> Iterator[Figure]:
        """Yield the figures of a surface."""
        yield from (figure for figure in self.figures if surface not in figure.absent)

    def rows(self, summary: Mapping[str, Any], surface: Surface) -> list[SummaryRow]:
        """Return the rows of a summary's JSON on a surface; one without a value is left out."""
        rows: dict[str, SummaryRow] = {}
        for figure in self.on(surface):
            if figure.phrase is None:
                parts, headline = _parts(figure, summary), ""
                if parts and figure.headline is not None:
                    headline = figure.headline(figure.value(summary))
            elif figure.row in rows:
                continue
            else:
                parts, headline = _phrase(*figure.phrase, summary)
            if parts or (headline and surface is Surface.PAGE):
                row = rows.get(figure.row, SummaryRow(figure.row, (), headline))
                rows[figure.row] = row._replace(parts=row.parts + parts)
        return list(rows.values())

    def row_names(self, surface: Surface) -> list[str]:
        """Return the names of the rows that a surface may have."""
        return list(dict.fromkeys(figure.row for figure in self.on(surface)))

    def cells(self, summary: Mapping[str, Any], surface: Surface) -> dict[str, str]:
        """Return the value of each figure of a surface, by its name; empty without one."""
        parts = (part for row in self.rows(summary, surface) for part in row.parts)
        found = {part.name: f"{part.value}{part.detail}" for part in parts}
        return {each.name: found.get(each.name, "") for each in self.on(surface)}


def _phrase(key: str, row: Row, summary: Mapping[str, Any]) -> tuple[tuple[RowPart, ...], str]:
    table = value_at(summary, key) or {}
    text = row.show(table) if row.show else None
    return (RowPart(row.name, "", text, text),) if text else (), row.headline(
        table
    ) if row.headline else ""


def _parts(figure: Figure, summary: Mapping[str, Any]) -> tuple[RowPart, ...]:
    value = figure.shown(summary)
    if value is None:
        return ()
    detail = ""
    if figure.of:
        share = value_at(summary, f"availability.{figure.of}")
        run = "" if share is None else f" ({100 * share:.1f} % of the run)"
        detail = f" of the time {figure.of}{run}"
    text = figure.text.replace("{}", value)
    return (RowPart(figure.name, figure.joint, value, text, detail, figure.lead),)


def absent(reason: str, *surfaces: Surface) -> dict[Surface, str]:
    """Return that figures are absent from surfaces (from all of them without any) for a reason."""
    return dict.fromkeys(surfaces or tuple(Surface), reason)


def texts(values: Iterable[str], between: str = ", ") -> str | None:
    """Return texts in one line; None without any."""
    return between.join(values) or None
