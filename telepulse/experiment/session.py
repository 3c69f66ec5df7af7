"""The session file, and the trials drawn for it, in order.

In an ABX trial a subject feels A, B and X, and answers which of A and B the last one was.
"""

from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from display_node.scene import DisplayScene
from protocol.config.quantities import Name, Nanoseconds
from protocol.config.scene import Section, validate
from protocol.config.scene_file import find_scene, load_document, load_toml
from protocol.provenance import redact
from telepulse.scene import Scene, load_scene
from telepulse.simulation.link_scene import LinkScene, parse_link

Kind = Literal["abx", "rating"]
Count = Annotated[int, Field(strict=True, ge=1, le=10_000)]


def _link(text: object) -> LinkScene:
    if not isinstance(text, str):
        raise ValueError('must be a text such as "delay=40ms,loss=1%"')
    return parse_link(text)


class Condition(Section):
    """A link that is compared with direct playback.

    compensation and predictor replace the scene's.
    """

    name: Name
    link: Annotated[LinkScene, BeforeValidator(_link)]
    compensation: str | None = None
    predictor: str | None = None


class SessionTable(Section):
    """The session of one subject.

    trials: number for each condition. catch: number of further trials without a link. interval:
    time at full strength. settle: time for which the stream plays before it is felt. replays: limit
    of the playings of each letter in a trial. seed: of all random numbers; by default each run
    draws its own.
    """

    scene: str
    kind: Kind
    conditions: Annotated[tuple[Condition, ...], Field(min_length=1, max_length=100)]
    title: str = ""
    trials: Count = 16
    catch: Annotated[int, Field(strict=True, ge=0, le=10_000)] = 0
    interval_ns: Annotated[Nanoseconds, Field(ge=100_000_000, le=60_000_000_000)] = 4_000_000_000
    settle_ns: Annotated[Nanoseconds, Field(ge=0, le=60_000_000_000)] = 500_000_000
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
    def joining_ns(self) -> int:
        """Time in ns within which a display has joined the stream over any of the links.

        It is 0.8 s without a link. A link adds 4 times its delay and 6 times its jitter.
        """
        links = [condition.link for condition in self.conditions]
        return 800_000_000 + max(4 * link.delay_ns + 6 * link.jitter_ns for link in links)


class SessionPlan(NamedTuple):
    """A session file that was read.

    tables: tables of the file and of its scene, for the log. direct: the scene without a link.
    impaired: a scene for each condition, by the condition's name.
    """

    session: SessionTable
    tables: dict[str, Any]
    direct: Scene
    impaired: dict[str, Scene]


def load_plan(path: Path) -> SessionPlan:
    """Read a session file and its scene. Raises SceneError."""
    written = load_toml(path, "session file")
    session = validate(written, SessionTable, where=f"{path}:")
    # A scene's name, or its path from the folder of the session file.
    scene_path = path.parent / find_scene(session.scene)
    scene = load_scene(scene_path)
    document = load_document(scene_path)
    direct = replace(scene, link=LinkScene())
    impaired = {}
    for condition in session.conditions:
        given = condition.model_dump(include={"compensation", "predictor"}, exclude_none=True)
        where = f"{path}: {condition.name!r}:"
        display = validate({**document["display"], **given}, DisplayScene, where)
        impaired[condition.name] = replace(scene, link=condition.link, display=display)
    return SessionPlan(session, redact({"session": written, "scene": document}), direct, impaired)


Letter = Literal["A", "B", "X"]
LETTERS: dict[str, tuple[Letter, ...]] = {"abx": ("A", "B", "X"), "rating": ("A", "X")}
"""Letters that are felt in a trial of each kind."""


class Trial(BaseModel):
    """A trial. direct: the one of A and B that has no link; x: the one that X is.

    condition: None in a catch trial, which has no link. In a rating, A is the open reference and
    always direct, and X is B.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    condition: str | None
    direct: Literal["A", "B"]
    x: Literal["A", "B"]
    pulse_seed: int

    def on_link(self, letter: Letter) -> bool:
        """Return whether a letter of this trial is felt over the link."""
        return self.condition is not None and (self.x if letter == "X" else letter) != self.direct


def draw_trials(session: SessionTable, seed: int) -> tuple[Trial, ...]:
    """Return all trials in their order: the wanted number for each condition, shuffled.

    `direct` and `x` are drawn for each trial independently, and are not balanced over the trials.
    So a guess is right with a probability of one half, whatever the subject noticed before.
    """
    random = Random(f"trials {seed}")
    names: list[str | None] = [c.name for c in session.conditions for _ in range(session.trials)]
    names += [None] * session.catch
    random.shuffle(names)
    trials = []
    for name in names:
        seed, direct, x = random.getrandbits(31), "A", "B"
        if session.kind == "abx":
            direct, x = random.choice("AB"), random.choice("AB")
        trial = {"condition": name, "direct": direct, "x": x, "pulse_seed": seed}
        trials.append(Trial.model_validate(trial))
    return tuple(trials)
