"""The session file: what is compared, how often, for how long.

The trials of a session: which link, what is A and B and X, in which order. Pure.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from random import Random
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from display_node.prediction import PredictorName
from display_node.scene import DisplayScene
from protocol.config.quantities import Nanoseconds
from protocol.config.scene import Section, validate
from protocol.config.scene_file import find_scene, load_document, load_toml
from protocol.provenance import redact
from protocol.wire.stream import Name
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_model import LinkScene, parse_link

# By then a display has joined and plays: so long over no link, and so many times the link's delay
# and jitter more.
JOINED_NS = 800_000_000
DELAYS, JITTERS = 4, 6

Kind = Literal["abx", "rating"]
Felt = Annotated[Nanoseconds, Field(ge=100_000_000, le=60_000_000_000)]
Settle = Annotated[Nanoseconds, Field(ge=0, le=60_000_000_000)]
Count = Annotated[int, Field(strict=True, ge=1, le=10_000)]


def _link(text: object) -> LinkScene:
    if not isinstance(text, str):
        raise ValueError('must be a text such as "delay=40ms,loss=1%"')
    return parse_link(text)


class Condition(Section):
    """A link that is compared with direct playback; compensation and predictor, where given, are
    in place of the scene's."""

    name: Name
    link: Annotated[LinkScene, BeforeValidator(_link)]
    compensation: str | None = None
    predictor: PredictorName | None = None


class SessionTable(Section):
    """One subject's sitting.

    trials: of each condition. catch: further ones without a link at all. interval: how long the
    pulse is felt at its full strength each time; settle: how long it is played before, unfelt.
    replays: how often each interval of a trial may be felt. seed: without one, each run draws
    its own.
    """

    scene: str
    kind: Kind
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1, max_length=100)]
    title: str = ""
    trials: Count = 16
    catch: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 0
    interval_ns: Felt = 4_000_000_000
    settle_ns: Settle = 500_000_000
    replays: Count | None = None
    seed: Annotated[int, Field(strict=True, ge=0)] | None = None

    @model_validator(mode="after")
    def _have_names(self) -> Self:
        names = [condition.name for condition in self.conditions]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two conditions have the name {name!r}")
        return self

    @property
    def joined_ns(self) -> int:
        """Time from which a display plays the stream over any of the links, in ns."""
        links = [condition.link for condition in self.conditions]
        waits_ns = [DELAYS * link.delay_ns + JITTERS * link.jitter_ns for link in links]
        return JOINED_NS + max(waits_ns)


@dataclass(frozen=True, slots=True)
class SessionPlan:
    """A session file, read: as it is written, and what it means.

    tables: the file's and its scene's, by name, for the log. direct: the scene without a link;
    impaired: by the condition's name.
    """

    session: SessionTable
    tables: dict[str, Any]
    direct: Scene
    impaired: dict[str, Scene]


def load_plan(path: Path) -> SessionPlan:
    """Read a session file and its scene. Raises SceneError."""
    written = load_toml(path, "session file")
    session = validate(written, SessionTable, where=f"{path}:")
    # By name, or by a path from the session's own folder.
    scene_path = path.parent / find_scene(session.scene)
    scene = load_scene(scene_path)
    document = load_document(scene_path)
    direct = replace(scene, link=LinkScene())
    impaired = {
        condition.name: replace(
            scene,
            link=condition.link,
            display=_display(document["display"], condition, f"{path}: {condition.name!r}:"),
        )
        for condition in session.conditions
    }
    return SessionPlan(session, redact({"session": written, "scene": document}), direct, impaired)


def _display(table: dict[str, Any], condition: Condition, where: str) -> DisplayScene:
    given = condition.model_dump(include={"compensation", "predictor"}, exclude_none=True)
    return validate({**table, **given}, DisplayScene, where)


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


def draw_trials(session: SessionTable, seed: int) -> tuple[Trial, ...]:
    """All trials in their order: as many of each condition as asked for, shuffled.

    What is A and what is X is drawn for each trial alone, not balanced over them: only then is a
    guess right with a chance of exactly one half, whatever was noticed of the trials before.
    """
    random = Random(f"trials {seed}")
    names: list[str | None] = [c.name for c in session.conditions for _ in range(session.trials)]
    names += [None] * session.catch
    random.shuffle(names)
    return tuple(_draw(session, name, random) for name in names)


def _draw(session: SessionTable, condition: str | None, random: Random) -> Trial:
    pulse_seed = random.getrandbits(31)
    if session.kind == "rating":
        return Trial(condition=condition, direct="A", x="B", pulse_seed=pulse_seed)
    direct, x = random.choice("AB"), random.choice("AB")
    return Trial.model_validate(
        {"condition": condition, "direct": direct, "x": x, "pulse_seed": pulse_seed}
    )
