"""The criteria of the benchmarks, as data: what is judged, and its bound."""

from typing import Final, NamedTuple


class Criterion(NamedTuple):
    """A bound on one figure of a benchmark: at most `most`, at least `least`.

    Bounds and figures are in SI units, or have none; `scale` and `unit` are for people.
    """

    name: str
    most: float = float("inf")
    least: float = float("-inf")
    scale: float = 1.0
    unit: str = ""

    def holds(self, figure: float) -> bool:
        """Return whether a figure is within the bound; NaN is not."""
        return self.least <= figure <= self.most

    def shown(self, figure: float) -> str:
        """Return a figure in the unit for people."""
        return f"{self.scale * figure:.3g} {self.unit}".rstrip()

    @property
    def bound(self) -> str:
        """The bound in words."""
        bounds = {"at most": self.most, "at least": self.least}
        finite = {word: each for word, each in bounds.items() if abs(each) < float("inf")}
        return " and ".join(f"{word} {self.shown(each)}" for word, each in finite.items())


def share(name: str, most: float = float("inf"), least: float = float("-inf")) -> Criterion:
    """Return a criterion on a share, which people read in per cent."""
    return Criterion(name, most, least, 100.0, "%")


# By benchmark, in the order in which they are printed.
CRITERIA: Final[dict[str, tuple[Criterion, ...]]] = {
    "depth": (
        share("error of the best hold-down", most=0.05),
        share("range of the repeats, over their mean", most=0.05),
    ),
    "press": (
        *(
            criterion
            for where in ("own wrist", "other wrists", "over TCP")
            for criterion in (
                share(f"hold-down, {where}", most=0.05),
                share(f"height, {where}", most=0.1),
            )
        ),
        share("hold-down at other stiffnesses", most=0.05),
        Criterion("rise of what swings on after a step", most=0.0, scale=1e3, unit="mN"),
        Criterion("gain of the loop", most=0.1),
        Criterion("force at the wrist over its limit", most=1.0),
        Criterion("slew at the wrist over its limit", most=1.0),
        Criterion("force of the finger over its limit", most=1.0),
        # The slew of two set-points is measured over a time that is rounded to ticks.
        Criterion("slew of the finger over its limit", most=1.001),
        Criterion("time to ease off after a cut", most=0.5, unit="s"),
    ),
}
