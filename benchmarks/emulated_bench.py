"""The whole emulated bench against the same scene on the in-process model: is a real drive's path
through bytes and processes as true as the model is?
"""

import re
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.measure import show
from benchmarks.whole_bench import KINDS, BenchFailedError, playing
from telepulse.scene import find_scene, load_scene
from telepulse.simulate import simulate

SECONDS = 15.0
RUNS = 2
BAR_RATIO = 1.5
BAR_COMMANDS = 500.0
SOURCE = "real_bench"


def main() -> None:
    """Print the table. Bars: 1 kHz, 500 commands a second, an RMSE of 1.5 times the model's."""
    with TemporaryDirectory(prefix="telepulse-") as folder:
        base_n = model_rmse_n(Path(folder))
        rows = [row(kind, base_n) for _ in range(RUNS) for kind in KINDS]
    show(
        f"The whole emulated bench, {SECONDS:g} s a run: force RMSE (aligned) beside the in-process"
        f" model's of {base_n * 1e3:.2f} mN; bars: {BAR_RATIO} times it, 1000 samples and"
        f" {BAR_COMMANDS:g} commands a second",
        ("drive", "RMSE mN", "ratio", "samples/s", "commands/s", "missed ticks", "on the way"),
        sorted(rows),
    )


def row(kind: str, base_n: float) -> tuple[str, ...]:
    """A run as it stands in the table."""
    with TemporaryDirectory(prefix="telepulse-") as folder:
        try:
            with playing(Path(folder), kind, SOURCE) as bench:
                before, began_s = bench.await_state("playing"), time.monotonic()
                time.sleep(SECONDS)
                after, felt_s = bench.await_state("playing"), time.monotonic() - began_s
                summary = bench.end()
        except BenchFailedError as error:
            return kind, "none", "", "", "", "", str(error).splitlines()[0]
    sampled = after["samples"]["played"] - before["samples"]["played"]
    return figures(kind, summary, base_n, sampled / felt_s)


def figures(
    kind: str, summary: dict[str, Any], base_n: float, sampled_hz: float
) -> tuple[str, ...]:
    """A run's summary as it stands in the table."""
    loop = summary["loop"]
    rmse_n = summary["force_rmse_n"]["aligned"] or np.nan
    counts = summary["hardware"]
    told = loop["ticks"] - counts.get("drive superseded", 0)
    ran_s = (loop["ticks"] + loop["deadline_misses"]) * 2e-3
    on_the_way = [f"{count} {name}" for name, count in counts.items()] + summary["faults"]
    return (
        kind,
        f"{rmse_n * 1e3:.2f}",
        f"{rmse_n / base_n:.2f}",
        f"{sampled_hz:.0f}",
        f"{told / ran_s:.0f}",
        str(loop["deadline_misses"]),
        ", ".join(on_the_way) or "nothing",
    )


def model_rmse_n(folder: Path) -> float:
    """What the scene's models make of the same pulse, drive and sensors left out."""
    text = find_scene("tmcl_bench").read_text("utf-8")
    source = find_scene(SOURCE).read_text("utf-8")
    table = re.search(r"\[sensing\.source\].*?\n\n", source, re.DOTALL)
    assert table is not None
    text = re.sub(r"\[sensing\.source\].*?\n\n", table[0], text, flags=re.DOTALL)
    text = re.sub(r"\[display\.(drive|feedback)\][^[]*", "", text)
    path = folder / "model.toml"
    path.write_text(text, "utf-8")
    rmse_n = simulate(load_scene(path), SECONDS, seed=1).force_rmse_n.aligned
    assert rmse_n is not None
    return rmse_n
