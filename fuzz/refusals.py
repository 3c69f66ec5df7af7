"""The permitted reaction of a decoder to bad bytes: a refusal for a documented cause."""

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from protocol.errors import WireError

LONGEST_LINE = 1000
_TABLE = Path(__file__).parents[1] / "docs" / "wire.md"
CAUSES = frozenset(
    re.findall(r"`(\w+)`", _TABLE.read_text(encoding="utf-8").split("counted as")[1])
)


@contextmanager
def refusals() -> Iterator[None]:
    """Suppress a WireError whose cause is documented, and nothing else."""
    try:
        yield
    except WireError as error:
        check_causes([error.cause])


def check_line(error: Exception) -> None:
    """Raise AssertionError for an error that is not one readable line."""
    line = str(error)
    assert "\n" not in line
    assert len(line) <= LONGEST_LINE, line[:LONGEST_LINE]


def check_causes(causes: Iterable[str]) -> None:
    """Raise AssertionError for a cause of refusal that is missing from docs/wire.md."""
    unknown = set(causes) - CAUSES
    assert not unknown, f"causes that docs/wire.md does not have: {unknown}"
