"""Meaning and presentation of the summary's figures: the table `figures.toml`, read once.

The table that `--details` prints, live page, Prometheus, the report of a recording and the
reference read the same entries. A new figure is a field in `fields.py` and an entry there.
"""

import dataclasses
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple, get_type_hints

from protocol.summary.fields import Summary
from protocol.summary.phrases import COUNT, HEADLINES, PHRASES, UNITS, Unit

TABLE = Path(__file__).with_name("figures.toml")
_METRIC = re.compile(r"(?P<name>\w*?)(?P<counter>_total)?(?:\{(?P<labels>.*)\})?")
Entry = Mapping[str, Any]
# Keys of an entry that become something else; the others are fields of `Figure` as they stand.
READ = {
    *("row", "of_felt", "noun", "keys", "unit", "form", "show", "headline", "metric"),
    *("left_out", "like"),
}


class Surface(StrEnum):
    """A place where people or programs read the figures, besides the JSON."""

    SUMMARY = "table of --details"
    PAGE = "live page"
    REPORT = "report of a recording"
    METRICS = "metrics"


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure of the summary; `figures.toml` explains the fields that are not explained here.

    key: the keys in the JSON, joined by dots. type: of the field. phrase: the table's figure, if
    the whole table is shown as one phrase. show: formats a value that is no number, or a whole
    table; returns None to hide it.
    """

    key: str
    type: Any
    phrase: "Figure | None" = None
    meaning: str = ""
    row: str = ""
    title: str = ""
    text: str = "{}"
    of_felt: bool = False
    after_fault: str = ""
    noun: tuple[str, ...] = ()
    unit: Unit | None = None
    separator: str = ", "
    show_zero: bool = True
    share_of: str = ""
    prominent: bool = False
    show: Callable[[Any], str | None] | None = None
    headline: Callable[[Any], str] | None = None
    metric: str = ""
    counter: bool = False
    labels: Mapping[str, str] = field(default_factory=dict)
    label: str = ""
    keys: tuple[str, ...] = ()
    help: str = ""
    absent: Mapping[Surface, str] = field(default_factory=dict)

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
        return value_at(summary, self.key)


def value_at(summary: Any, key: str) -> Any:
    """Return the value of a summary's JSON under keys that are joined by dots; None without one."""
    for name in key.split("."):
        summary = summary.get(name) if isinstance(summary, Mapping) else None
    return summary


@cache
def figures() -> tuple[Figure, ...]:
    """Return the figures of a summary, in the order of its fields."""
    entries = tomllib.loads(TABLE.read_text(encoding="utf-8"))
    return tuple(Reader(entries.pop("reasons"), entries).figures(Summary))


def figures_on(surface: Surface) -> Iterator[Figure]:
    """Yield the figures of a surface."""
    return (figure for figure in figures() if surface not in figure.absent)


class Reader(NamedTuple):
    """Reader of the table's entries. reasons: those that several figures share, by their name."""

    reasons: Mapping[str, Mapping[str, str]]
    entries: Entry

    def figures(self, kind: type, shared: Figure = Figure("", None)) -> Iterator[Figure]:
        """Yield the figures of a dataclass and of its tables, with settings inherited from a table.

        Raises TypeError for a field without an entry, and for an entry without a field.
        """
        hints = get_type_hints(kind)
        names = [each.name for each in dataclasses.fields(kind)]
        unknown = {name for name, entry in self.entries.items() if isinstance(entry, dict)}
        if unknown := unknown - {*names, "absent", "only"}:
            raise TypeError(f"{TABLE.name}: {kind.__name__} has no {', '.join(sorted(unknown))}")
        for name in names:
            if name not in self.entries:
                raise TypeError(f"{TABLE.name}: {kind.__name__}.{name} has no entry")
            key = f"{shared.key}.{name}" if shared.key else name
            found = self._completed(self.entries[name], key, hints[name], shared)
            if isinstance(found.type, type) and dataclasses.is_dataclass(found.type):
                inner = found if found.show is None else dataclasses.replace(found, phrase=found)
                entry = self.entries[name]
                like = self.entries[entry["like"]] if "like" in entry else {}
                yield from self._replace(entries={**like, **entry}).figures(found.type, inner)
            else:
                yield found

    def _completed(self, entry: Entry, key: str, kind: Any, shared: Figure) -> Figure:
        """Return the figure of an entry; what it leaves out is that of its table."""
        match = _METRIC.fullmatch(entry.get("metric", ""))
        assert match is not None
        labels = dict(re.findall(r'(\w+)="([^"]*)"', match["labels"] or ""))
        unit = UNITS[entry["unit"]] if "unit" in entry else shared.unit
        if "form" in entry:
            unit = (unit or COUNT)._replace(form=entry["form"])
        plain = {
            name: value
            for name, value in entry.items()
            if name not in READ and not isinstance(value, dict)
        }
        # A key that no figure has is a TypeError here.
        return Figure(
            key,
            kind,
            shared.phrase,
            row=entry.get("row", (shared.phrase or shared).row),
            of_felt=entry.get("of_felt", shared.of_felt),
            noun=tuple(entry.get("noun", ())),
            keys=tuple(entry.get("keys", ())),
            unit=unit,
            show=PHRASES[entry["show"]] if "show" in entry else None,
            headline=HEADLINES[entry["headline"]] if "headline" in entry else None,
            metric=match["name"] or shared.metric,
            counter=match["counter"] is not None,
            labels={**shared.labels, **labels},
            absent={**shared.absent, **self._absent(entry)},
            **plain,
        )

    def _absent(self, entry: Entry) -> dict[Surface, str]:
        surfaces = {each.name.lower(): each for each in Surface}
        found: dict[str, str] = {}
        for name in entry.get("left_out", ()):
            found |= self.reasons[name]
        for here, reason in entry.get("only", {}).items():
            found |= dict.fromkeys(surfaces.keys() - {here}, reason)
        return {surfaces[name]: text for name, text in (found | entry.get("absent", {})).items()}
