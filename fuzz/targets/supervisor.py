"""Events on the host's side of a drive: the search of tests/support/supervised_drive.py, guided.

The first byte chooses the kind of drive; each three bytes after it are an event.
"""

from tests.support.supervised_drive import KINDS, PRESS, events_of, play

# An input of more would take longer than the fuzzer lets it.
MOST_EVENTS = 20
_STEPS = ((0, 40, 7), (8, 20, 3), (10, 30, 1), (4, 40, 10), (7, 9, 0), (13, 3, 57), (15, 50, 0))


def seeds() -> list[bytes]:
    """Return a few events, alone and together, on each kind of drive."""
    runs = [*((step,) for step in _STEPS), _STEPS]
    return [
        bytes([kind, *(byte for step in run for byte in step)])
        for kind in range(len(KINDS))
        for run in runs
    ]


def try_one(data: bytes) -> None:
    """Play events on a pressed tip; an invariant that does not hold raises."""
    kind = KINDS[data[0] % len(KINDS)] if data else KINDS[0]
    numbers = [data[at : at + 3] for at in range(1, len(data) - 2, 3)][:MOST_EVENTS]
    play(kind, [PRESS, *events_of((a, b, c) for a, b, c in numbers)])
