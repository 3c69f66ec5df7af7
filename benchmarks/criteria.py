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
    "announce": (
        Criterion("variability, 100 ms ahead: mean of the seeds", most=0.12),
        Criterion("variability, 100 ms ahead: worst of the seeds", most=0.12),
        Criterion("ectopic, 100 ms ahead: mean of the seeds", most=0.16),
        Criterion("ectopic, 100 ms ahead: worst of the seeds", most=0.16),
        Criterion("fibrillation, 100 ms ahead: mean of the seeds", most=0.15),
        Criterion("fibrillation, 100 ms ahead: worst of the seeds", most=0.15),
        Criterion("variability, shape cue, 100 ms ahead: mean of the seeds", most=0.12),
        Criterion("ectopic, shape cue, 100 ms ahead: mean of the seeds", most=0.16),
        Criterion("fibrillation, shape cue, 100 ms ahead: mean of the seeds", most=0.15),
        share("greatest rise of an error where the transit time varies by 20 ms", most=0.005),
        share("greatest rise of an error of the recordings", most=0.005),
        Criterion("time until a wrong ECG is unused", most=3.0, unit="s"),
        share("use of a wrong ECG from then on", most=0.05),
        share("rise of the error 100 ms ahead from 3 s after a jump", most=0.005),
        share("sensitivity of the R waves of annotated records", least=0.99),
        share("precision of the R waves of annotated records", least=0.99),
        Criterion("processor time with the ECG over that without", most=1.3),
    ),
    "prediction": (
        Criterion("stack over its best member, worst", most=1.02),
        Criterion("median, stack: over prototype", most=1.05),
        Criterion("median, analogue 0.05 s: over prototype", most=1.05),
        Criterion("median, fir: over prototype", most=1.05),
        Criterion("median, hold: over prototype", most=1.05),
        Criterion("variability, stack: over prototype", most=1.05),
        Criterion("variability, stack: over its oracle", most=1.0),
        Criterion("variability, stack: over goal", most=1.0),
        Criterion("ramp, stack: over prototype", most=1.05),
        Criterion("ramp, stack: over its oracle", most=1.0),
        Criterion("ramp, stack: over goal", most=1.0),
        Criterion("ectopic, stack: over prototype", most=1.05),
        Criterion("ectopic, stack: over its oracle", most=1.0),
        Criterion("fibrillation, stack: over prototype", most=1.05),
        Criterion("fibrillation, stack: over its oracle", most=1.0),
        Criterion("tick of the stack, 99th percentile", 150e-6, scale=1e6, unit="µs"),
    ),
    "in_phase": (
        Criterion("regret, median", most=1.05),
        Criterion("regret, worst", most=1.25),
        share("time noticed beyond the target, worst", most=0.01),
        Criterion("expected over actual RMS error, median", most=1.2, least=0.8),
        Criterion("expected over actual time noticed, median", most=2.0, least=0.5),
    ),
    # Our mean delay over the optimum's, both at 1 % late.
    "playout": (
        Criterion("Gaussian / best constant", most=1.05),
        Criterion("100 ms spikes / best constant", most=1.05),
        Criterion("Gaussian / best moving, 5 %", most=1.15),
        Criterion("+60 ms route / best moving, 5 %", most=1.15),
        Criterion("+200 ppm / best moving, 5 %", most=1.15),
        Criterion("−200 ppm / best moving, 5 %", most=1.15),
        Criterion("Markov bursts / best moving, 5 %", most=1.2),
        Criterion("random spikes / best moving, 5 %", most=1.6),
        Criterion("TCP stalls / best moving, 5 %", most=1.7),
    ),
    # Errors are over the pulse's peak to peak.
    "loop": (
        Criterion("change of the reference on halving its step", most=1e-10),
        share("error of the display's own way at 1 ms, following the pulse", most=1e-3),
        Criterion("hard cases that are unbounded", most=0),
    ),
    # In the units of their names.
    "core": (
        Criterion("work of the stack in µs a tick", most=15),
        Criterion("simulate radial, linear", least=30),
        Criterion("simulate radial, stack", least=20),
        Criterion("live tick, p50 in µs", most=110),
        Criterion("live tick, p99 in µs", most=350),
        Criterion("live wake-up to command, p50 in µs", most=80),
        Criterion("live wake-up to command, p99 in µs", most=200),
        Criterion("latency over pyzmq", most=1.2),
        Criterion("latency over pyzmq, CURVE", most=1.2),
        Criterion("16 seeds of 60 s in turn over a sweep", least=1.9),
        Criterion("growth of memory in MB/h", most=6),
    ),
    "contactors": (
        share("a further contactor's tick over the first one's, stack", most=0.4),
        share("a further contactor's tick over the first one's, linear", most=0.4),
        Criterion("skew between contactors", 0.1e-3, scale=1e3, unit="ms"),
    ),
    "drives": (
        Criterion("PDO of a velocity command, 99th percentile", 50e-6, scale=1e6, unit="µs"),
    ),
    "emulated_bench": (
        Criterion("benches that did not play", most=0),
        Criterion("RMSE over the model's", most=1.5),
        Criterion("samples a second", least=1_000),
        Criterion("commands a second", least=500),
    ),
    "bench_faults": (
        Criterion("time from a fault until the tip rests or is off", 0.1, scale=1e3, unit="ms"),
        Criterion("force after a restart", most=2.5, unit="N"),
        Criterion("slew after a restart", most=50.0, unit="N/s"),
    ),
    "class_bench": (
        Criterion("aligned RMSE of a pulse of 300 mN", 3e-3, scale=1e3, unit="mN"),
        Criterion("the same, by the display", 3e-3, scale=1e3, unit="mN"),
        Criterion("steps lost while played", most=0),
        Criterion("step jitter", 45e-6, scale=1e6, unit="µs"),
        Criterion("highest step rate without a lost step", least=20e3, scale=1e-3, unit="kHz"),
        Criterion("time to withdraw after kill -9", 0.3, scale=1e3, unit="ms"),
        Criterion("time to withdraw after any fault", 0.3, scale=1e3, unit="ms"),
    ),
    "stalls": (Criterion("stalls that leave the tip pressed", most=0),),
    "faults": (
        Criterion("time until the pulse is felt again after a fault", most=1.0, unit="s"),
        Criterion("samples that no count names", most=0),
        Criterion("force at the finger", most=2.5, unit="N"),
        Criterion("slew of the target", most=50.0, unit="N/s"),
        Criterion("time until the pulse is felt again after a cut", most=1.0, unit="s"),
        share("ticks missed by the display's own core time in a flood", most=0.01),
    ),
    "paths": (
        Criterion("p99 of three connections over that without loss", most=1.1),
        Criterion("samples lost over three", most=0),
    ),
    "peers": (
        Criterion("p50 of telepulse over that of pyzmq", most=1.25),
        Criterion("p50 of telepulse, CURVE over that of pyzmq, CURVE", most=1.25),
        Criterion("p50 of telepulse over that of LSL", most=1.0),
    ),
    "clock": (
        Criterion("error of the offset after 5 s", 1e-3, scale=1e3, unit="ms"),
        Criterion("error of the offset after 60 s", 0.3e-3, scale=1e3, unit="ms"),
        Criterion("error of the skew after 60 s", 5e-6, scale=1e6, unit="ppm"),
        Criterion("RMS error over LSL's at 0 ppm, its easiest", most=0.33),
    ),
    "load": (Criterion("time until a relay has frames again after a cut", most=1.0, unit="s"),),
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
