"""Dialogue of a trial, key by key. Pure, and blind: it has no access to the trial."""

from collections import Counter
from dataclasses import dataclass
from typing import Literal

from protocol.config.quantities import count_text
from telepulse.experiment.session import LETTERS, Kind, Letter

STOP_KEY = "q"
ANSWERS: dict[str, dict[str, Literal["A", "B", 1, 2, 3, 4, 5]]] = {
    "abx": {"1": "A", "2": "B"},
    "rating": {"1": 1, "2": 2, "3": 3, "4": 4, "5": 5},
}
HELP: dict[str, str] = {
    "abx": "a, b, x: feel it.  1: X is A.  2: X is B.  q: stop.",
    "rating": "a: feel the direct touch.  x: feel X.  How close is X to A?"
    "  5: the same, 4: close, 3: somewhat off, 2: far, 1: nothing like it.  q: stop.",
}


@dataclass(frozen=True, slots=True)
class Feel:
    """Let the subject feel an interval, for the nth time."""

    letter: Letter
    nth: int


@dataclass(frozen=True, slots=True)
class Answer:
    """The trial is answered."""

    value: Literal["A", "B", 1, 2, 3, 4, 5]


@dataclass(frozen=True, slots=True)
class Say:
    """Tell the subject why a key does nothing."""

    text: str


class Stop:
    """The session is to end."""


class Dialogue:
    """The dialogue of one trial: keys come in, the actions they ask for go out."""

    def __init__(self, kind: Kind, replays: int | None) -> None:
        self._kind = kind
        self._replays = replays
        self._felt: Counter[str] = Counter()

    def press(self, key: str) -> Feel | Answer | Say | Stop:
        """A key was pressed."""
        letters = {letter.lower(): letter for letter in LETTERS[self._kind]}
        if key == STOP_KEY:
            return Stop()
        if key in letters:
            return self._feel(letters[key])
        answers = ANSWERS[self._kind]
        if key not in answers:
            return Say(HELP[self._kind])
        missing = [letter for letter in letters.values() if not self._felt[letter]]
        if missing:
            return Say(f"feel {' and '.join(missing)} first")
        return Answer(answers[key])

    def _feel(self, letter: Letter) -> Feel | Say:
        if self._replays is not None and self._felt[letter] >= self._replays:
            return Say(
                f"{letter} was felt {count_text(self._felt[letter], 'time')}; no more in this trial"
            )
        self._felt[letter] += 1
        return Feel(letter, self._felt[letter])
