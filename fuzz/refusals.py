"""The permitted reaction of a decoder to bad bytes: a refusal for a documented cause."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

from protocol.errors import WireError
from protocol.refusals import CAUSE_MEANINGS

LONGEST_LINE = 1000


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
    """Raise AssertionError for a cause of refusal that is missing from protocol/refusals.py."""
    unknown = set(causes) - CAUSE_MEANINGS.keys()
    assert not unknown, f"causes without a meaning: {unknown}"
