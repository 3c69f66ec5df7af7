"""The trials of a session: which link, what is A and B and X, in which order. Pure."""

from random import Random
from typing import Literal

from pydantic import BaseModel, ConfigDict

from telepulse.experiment.session import Session

Letter = Literal["A", "B", "X"]
LETTERS: dict[str, tuple[Letter, ...]] = {"abx": ("A", "B", "X"), "rating": ("A", "X")}
"""What is felt in a trial of a kind."""


class Trial(BaseModel):
    """One trial. direct: which of A and B is felt without a link; x: which of them X is.

    condition: None in a catch trial, where nothing is felt over a link. In a rating A is the
    open reference, always direct, and B is what X may be.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    condition: str | None
    direct: Literal["A", "B"]
    x: Literal["A", "B"]
    pulse_seed: int

    def on_link(self, letter: Letter) -> bool:
        """Whether an interval of this trial is felt over the link."""
        return self.condition is not None and (self.x if letter == "X" else letter) != self.direct


def draw_trials(session: Session, seed: int) -> tuple[Trial, ...]:
    """All trials in their order: as many of each condition as asked for, shuffled.

    What is A and what is X is drawn for each trial alone, not balanced over them: only then is a
    guess right with a chance of exactly one half, whatever was noticed of the trials before.
    """
    random = Random(f"trials {seed}")
    names: list[str | None] = [c.name for c in session.conditions for _ in range(session.trials)]
    names += [None] * session.catch
    random.shuffle(names)
    return tuple(_draw(session, name, random) for name in names)


def _draw(session: Session, condition: str | None, random: Random) -> Trial:
    pulse_seed = random.getrandbits(31)
    if session.kind == "rating":
        return Trial(condition=condition, direct="A", x="B", pulse_seed=pulse_seed)
    direct, x = random.choice("AB"), random.choice("AB")
    return Trial.model_validate(
        {"condition": condition, "direct": direct, "x": x, "pulse_seed": pulse_seed}
    )
