"""Differences between signals and the file that was written of them, for people.

Each is found by reading the file back, so that it holds for every format alike.
"""

from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Iterator

from protocol.config.quantities import count_text
from sensing_node.files.signals import FileMark, SignalFile, SignalInfo, SignalTable

# Differences of times that are roundings: of annotations in s, and of a begin in ns.
SAME_TIME_S, SAME_BEGIN_NS = 1e-3, 1_000
SAME_RATE = 1e-9
MOST_CHARACTERS, SHORT = 400, 40


def losses(table: SignalTable, file: SignalFile) -> list[str]:
    """Return what a file, which was written of a table, lacks or has otherwise."""
    held = SignalTable(file.signals, (), file.begin_ns, file.marks).from_first_sample()
    return [
        *_of_signals(table.signals, file.signals),
        *_of_begin(table.begin_ns, held.begin_ns),
        *_of_marks(table.marks, held.marks),
        *_of_texts(table, file),
    ]


def _of_signals(given: Iterable[SignalInfo], held: tuple[SignalInfo, ...]) -> Iterator[str]:
    signals = list(given)
    if len(held) < len(signals):
        missing = Counter(each.name for each in signals) - Counter(each.name for each in held)
        yield _line("left out", missing.elements())
        return
    # Times are columns before them.
    pairs = list(zip(signals, held[len(held) - len(signals) :], strict=True))
    yield from _changes("names", ((_short(old.name), _short(new.name)) for old, new in pairs))
    yield from _changes("units", ((_unit(old, old), _unit(old, new)) for old, new in pairs))
    for old, new in pairs:
        if old.rate_hz and new.rate_hz and abs(new.rate_hz / old.rate_hz - 1) > SAME_RATE:
            yield f"{old.name} has {new.rate_hz:.9g} Hz in place of {old.rate_hz:.9g} Hz"


def _short(name: str) -> str:
    return name if len(name) <= SHORT else f"{name[: SHORT - 1]}…"


def _unit(signal: SignalInfo, held: SignalInfo) -> str:
    """Return the unit of a signal as the file has it; NU is WFDB's for none."""
    return f"{held.unit if held.unit not in ('', 'NU') else 'none'} of {_short(signal.name)}"


def _changes(what: str, pairs: Iterable[tuple[str, str]]) -> Iterator[str]:
    changed = [f"{old} is written as {new}" for old, new in pairs if old != new]
    if changed:
        yield _line(f"{what} are changed", changed)


def _of_begin(given_ns: int | None, held_ns: int | None) -> Iterator[str]:
    if given_ns is None:
        return
    if held_ns is None:
        yield "the begin is left out"
    elif abs(held_ns - given_ns) > SAME_BEGIN_NS:
        yield f"the begin is rounded by {abs(held_ns - given_ns) * 1e-6:.3g} ms"


def _of_marks(given: Iterable[FileMark], held: Iterable[FileMark]) -> Iterator[str]:
    rest = defaultdict[str, deque[FileMark]](deque)
    for mark in sorted(held, key=_order):
        rest[mark.text].append(mark)
    missing = without_length = 0
    for mark in sorted(given, key=_order):
        same = rest[mark.text]
        while same and same[0].at_s < mark.at_s - SAME_TIME_S:
            same.popleft()
        if not same or same[0].at_s > mark.at_s + SAME_TIME_S:
            missing += 1
            continue
        lengths_s = (mark.length_s or 0.0) - (same.popleft().length_s or 0.0)
        without_length += abs(lengths_s) > SAME_TIME_S
    if missing:
        yield f"{count_text(missing, 'annotation is', 'annotations are')} left out"
    if without_length:
        yield f"{count_text(without_length, 'annotation is', 'annotations are')} without length"


def _order(mark: FileMark) -> float:
    return mark.at_s


def _of_texts(table: SignalTable, file: SignalFile) -> Iterator[str]:
    missing = [key for key in table.metadata if key not in file.metadata]
    if missing:
        yield _line("texts are left out", missing)
    changed = [key for key, text in table.metadata.items() if file.metadata.get(key, text) != text]
    if changed:
        yield _line("texts are changed", changed)


def _line(what: str, parts: Iterable[str]) -> str:
    text = ", ".join(parts)
    return f"{what}: {text if len(text) <= MOST_CHARACTERS else text[: MOST_CHARACTERS - 1] + '…'}"
