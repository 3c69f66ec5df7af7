"""A model of a network link: delay, jitter, loss. Pure: it says when a message arrives.

Messages are independent of each other and may overtake one another, as datagrams do.
"""

import random
from typing import Annotated

from pydantic import Field

from protocol.quantities import Nanoseconds, Ratio
from protocol.scene import Section, validate


class LinkScene(Section):
    """The [link] section, for simulation and demo. jitter: standard deviation of a Gaussian
    added to the delay; a delay is never below 0. loss: share of data frames that vanish."""

    delay_ns: Annotated[Nanoseconds, Field(ge=0, le=10_000_000_000)] = 0
    jitter_ns: Annotated[Nanoseconds, Field(ge=0, le=10_000_000_000)] = 0
    loss: Annotated[Ratio, Field(ge=0, le=1)] = 0.0

    def text(self) -> str:
        """The link as `parse_link` reads it."""
        return f"delay={self.delay_ns}ns,jitter={self.jitter_ns}ns,loss={self.loss}"


def parse_link(text: str) -> LinkScene:
    """A link as a command line has it: "delay=40ms,jitter=10ms,loss=1%". Raises SceneError."""
    table = {}
    for part in filter(None, text.split(",")):
        key, _, value = part.partition("=")
        table[key.strip()] = value.strip()
    return validate(table, LinkScene, where=f"--link {text!r}:")


class Link:
    """One direction of a link; the same seed gives the same fate to the same messages."""

    def __init__(self, scene: LinkScene, seed: int) -> None:
        self._scene = scene
        self._random = random.Random(seed)
        self.lost = 0

    def delay_ns(self) -> int:
        """How long the next message takes."""
        scene = self._scene
        if not scene.jitter_ns:
            return scene.delay_ns
        return max(0, round(self._random.gauss(scene.delay_ns, scene.jitter_ns)))

    def loses(self) -> bool:
        """Whether the next data frame vanishes."""
        if self._scene.loss and self._random.random() < self._scene.loss:
            self.lost += 1
            return True
        return False
