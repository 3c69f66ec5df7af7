"""What the prototype reached, and whether we do."""

from dataclasses import dataclass

from telepulse.reports.studies.prediction_scores import HORIZONS_MS, Errors

# "Met" allows for so much more than the prototype's figure.
ALLOWANCE = 0.05
MEDIAN = "median of the sets"
# The short memory, the best at most horizons, stands for the analogues.
ANALOGUE = "analogue 0.05 s"


@dataclass(frozen=True, slots=True)
class Bar:
    """The prototype's NRMSE, a horizon each, of a predictor on a set; None: not asked for."""

    where: str
    predictor: str
    whose: str
    figures: tuple[float | None, ...]
    allowance: float = ALLOWANCE


@dataclass(frozen=True, slots=True)
class BarVerdict:
    """A bar beside our figures."""

    bar: Bar
    ours: tuple[float, ...]

    def excess(self, at: int) -> float | None:
        """By which share ours is above the prototype's at a horizon; None where there is none."""
        figure = self.bar.figures[at]
        return None if figure is None else self.ours[at] / figure - 1

    @property
    def reached(self) -> bool:
        """Whether it is met at every horizon."""
        excesses = [self.excess(at) for at in range(len(HORIZONS_MS))]
        return all(excess is None or excess <= self.bar.allowance for excess in excesses)


BARS = (
    Bar(MEDIAN, "stack", "prototype", (0.045, 0.156, 0.321, 0.394)),
    Bar(MEDIAN, ANALOGUE, "prototype", (0.070, 0.206, 0.379, 0.433)),
    Bar(MEDIAN, "fir", "prototype", (0.055, 0.207, 0.486, 0.537)),
    Bar(MEDIAN, "hold", "prototype", (0.307, 0.715, 1.21, 1.54)),
    Bar("variability", "stack", "prototype", (0.027, 0.078, 0.214, 0.295)),
    Bar("variability", "stack", "its oracle", (0.021, 0.064, 0.142, 0.167), 0.0),
    Bar("variability", "stack", "prize", (None, None, 0.18, None), 0.0),
    Bar("ramp", "stack", "prototype", (0.036, 0.099, 0.192, 0.218)),
    Bar("ramp", "stack", "its oracle", (0.009, 0.025, 0.050, 0.059), 0.0),
    Bar("ramp", "stack", "prize", (None, None, 0.12, None), 0.0),
    Bar("ectopic", "stack", "prototype", (0.033, 0.093, 0.254, 0.341)),
    Bar("ectopic", "stack", "its oracle", (0.021, 0.065, 0.167, 0.249), 0.0),
    Bar("fibrillation", "stack", "prototype", (0.045, 0.159, 0.505, 0.776)),
    Bar("fibrillation", "stack", "its oracle", (0.045, 0.158, 0.528, 0.787), 0.0),
)


def judge(errors: dict[str, Errors], medians: Errors) -> list[BarVerdict]:
    """The bars on the sets that there are figures of; without medians, none on the median."""
    where = {MEDIAN: medians, **errors} if medians else errors
    return [BarVerdict(bar, where[bar.where][bar.predictor]) for bar in BARS if bar.where in where]
