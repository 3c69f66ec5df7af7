"""Statements in the lines above a table in text: its titles, its units and its rate."""

import re
from collections.abc import Callable, Sequence
from itertools import pairwise

from pulse_sensors.text_lines import UNITS
from sensing_node.files.clock import are_times
from sensing_node.files.recording_plausibility import LEAST_HZ, MOST_HZ
from sensing_node.files.signals import split_unit
from sensing_node.files.text_layout import is_comment

_NUMBER = re.compile(r"\d+(?:[.,]\d+)?(?:e[-+]?\d+)?", re.IGNORECASE)
_BEFORE = r"(?P<before>\d+(?:[.,]\d+)?)\s*"
# Each with whether it states the time between samples in place of the rate.
_STATEMENTS = [
    (re.compile(pattern, re.IGNORECASE), of_interval)
    for pattern, of_interval in (
        (r"(?:(sampl\w*|abtast|acquisition)[ _-]*(rate|freq\w*)|^\W*(s?rate|rate_hz|frequency)\b"
         r"|\bfs\b)(?P<before>)", False),
        (r"(sampl\w*[ _-]*(interval|period|time)|^\W*interval|\bdt\b)(?P<before>)", True),
        (_BEFORE + r"(samples?|sps|S)\s*(/|per)\s*s", False),
        (_BEFORE + r"[mµμu]?s\w*\s*(/|per)\s*sample", True),
    )
]  # fmt: skip
_PER_S = re.compile(r"(?<![a-z])k?hz\b", re.IGNORECASE)
_SECONDS = re.compile(r"(?<![a-z])[mµμu]?s(?=\b|ec)", re.IGNORECASE)
_FACTORS = {"khz": 1e3, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6}
_TITLES = re.compile(
    r"\W*((channel|signal|column|sensor)[ _]?(title|name|label)?|title|label|name)s?\W*",
    re.IGNORECASE,
)
_UNIT_NAMES = re.compile(r"\W*(unit|einheit)(s|en)?([ _]?names?)?\W*", re.IGNORECASE)
_UNIT_OF = re.compile(r"(.*\S)[ _]units?\s*[:=]\s*(\S+)", re.IGNORECASE)
_LISTED = re.compile(r"[\"'](?:column|channel|label|name|title)s?[\"']\s*:\s*\[([^\[\]]*)\]")
_OTHER_UNITS = re.compile(
    r"-|1|sample( interval)?s?|(hh:mm|mm:ss|yyyy|dd/)[a-z:./ -]*", re.IGNORECASE
)


def read_titles(lines: Sequence[str], split: Callable[[str], list[str]], width: int) -> list[str]:
    """Return a title of each column, with its unit, from the lines above a table.

    split: returns the cells of a line. width: number of the table's columns.
    """
    titles, units = [""] * width, [""] * width
    for line in lines:
        key, *cells = _key_row(split(_bare(line))) or [""]
        given = _fitted(cells, width)
        if given and _TITLES.fullmatch(key):
            titles = given
        elif given and _UNIT_NAMES.fullmatch(key) and are_units(cells):
            units = given
        elif (listed := _LISTED.search(line)) is not None:
            found = [each.strip("\"' ") for each in listed[1].split(",")]
            titles = found + titles[len(found) :] if len(found) <= width else titles
    above = [line for line in lines if not is_comment(line) or _fits(split(_bare(line)), width)]
    rows = [split(_bare(line)) for line in above]
    while rows and rows[-1] and all(_NUMBER.fullmatch(cell) for cell in rows[-1] if cell):
        # Counts of samples, or the like.
        rows.pop()
    if rows and are_units(rows[-1]) and len(rows[-1]) <= width:
        units = _fitted(rows.pop(), width) or units
    if rows and _fits(rows[-1], width) and (width > 1 or not is_comment(above[len(rows) - 1])):
        titles = _fitted(rows[-1], width) or titles
    for line in lines:
        stated = _UNIT_OF.fullmatch(_bare(line).strip('"'))
        for at, title in enumerate(titles):
            if stated and UNITS.fullmatch(stated[2]) and title.lower() == stated[1].lower():
                units[at] = stated[2]
    pairs = _pairs([_bare(line) for line in lines])
    if 0 < len(pairs) <= width:
        # A name above its unit, of each channel.
        titles[-len(pairs) :], units[-len(pairs) :] = zip(*pairs, strict=True)
    return [_titled(title, unit) for title, unit in zip(titles, units, strict=True)]


def _pairs(lines: Sequence[str]) -> list[tuple[str, str]]:
    """Return each name that has its unit in the line below it."""
    return [
        (name, unit)
        for name, unit in pairwise(lines)
        if _is_unit(unit) and not _is_unit(name) and re.fullmatch(r"[^\W\d][^:=,;\t]*", name)
    ]


def are_units(cells: Sequence[str]) -> bool:
    """Return whether a row has units and nothing else."""
    given = [cell.strip("()[] ") for cell in cells if cell.strip("()[] ")]
    return bool(given) and all(_is_unit(unit) for unit in given)


def stated_rate(lines: Sequence[str]) -> float | None:
    """Return the rate in Hz that a line states, by itself or by the time between samples."""
    for line in lines:
        for pattern, of_interval in _STATEMENTS:
            found = pattern.search(line)
            if found is None:
                continue
            number = found["before"] or (_NUMBER.search(line, found.end()) or ("",))[0]
            unit = (_SECONDS if of_interval else _PER_S).search(line, found.start())
            factor = _FACTORS.get(unit[0].lower(), 1.0) if unit else 1.0
            value = float(number.replace(",", ".") or 0) * factor
            rate_hz = 1 / value if of_interval and value else value
            if LEAST_HZ <= rate_hz <= MOST_HZ:
                return rate_hz
    return None


def _bare(line: str) -> str:
    """Return a line without the marks of a comment."""
    return line.strip().lstrip("#%/").strip()


def _key_row(cells: list[str]) -> list[str]:
    """Return the cells of a row, its first one cut at a colon or an equals sign if it is alone."""
    alone = len(cells) == 1
    return [cell.strip() for cell in re.split("[:=]", cells[0], maxsplit=1)] if alone else cells


def _fitted(cells: Sequence[str], width: int) -> list[str] | None:
    """Return a cell for each column, or None.

    One less may lack that of the times, the first column; one more has a name without a column.
    """
    if not width - 1 <= len(cells) <= width + 1 or not any(cells):
        return None
    return [""] * (width - len(cells)) + [cell.strip(" '") for cell in cells[:width]]


def _fits(cells: Sequence[str], width: int) -> bool:
    """Return whether a row may be that of the titles."""
    key = cells[0] if cells else "="
    words = [cell for cell in cells if cell and not _NUMBER.fullmatch(cell)]
    named = key[-1:] in ("=", ":") or (_UNIT_NAMES.fullmatch(key) and are_units(cells[1:]))
    return len(cells) in (width, width + 1) and bool(words) and not named


def _is_unit(text: str) -> bool:
    known = UNITS.fullmatch(text) is not None or are_times("", text)
    return known or _OTHER_UNITS.fullmatch(text) is not None


def _titled(title: str, unit: str) -> str:
    """Return a title with its unit in brackets, unless it has one itself."""
    unit = unit.strip("()[] ")
    return f"{title} [{unit}]" if unit and not split_unit(title)[1] else title
