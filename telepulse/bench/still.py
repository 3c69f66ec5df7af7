"""A scene's sensors while nothing presses, as models: what the live ones say is in `hardware`."""

from pathlib import Path

import numpy as np

from protocol.errors import BenchError
from sensing_node.scene import SensingScene, build_source
from sensing_node.sources.synthetic import SyntheticScene
from telepulse.bench.press import Pressed
from telepulse.bench.sensor_check import Heard


def still_source(scene: SensingScene, folder: Path, seconds: float) -> Heard:
    """A synthetic source without its pulse, heard through the scene's conditioning.

    Raises BenchError for a recording: there is no sensor to check.
    """
    if not isinstance(scene.source, SyntheticScene):
        raise BenchError("a recording cannot be still")
    still = {"peak_to_peak_n": 0.0, "preload_n": 0.0}
    changes: dict[str, object] = {"source": scene.source.model_copy(update=still)}
    if scene.conditioning is not None:
        changes["conditioning"] = scene.conditioning.model_copy(update={"hold_down_n": 0.0})
    source = build_source(scene.model_copy(update=changes), folder)
    count = round(seconds * 1e9 / source.period_ns)
    times_ns = np.arange(count) * source.period_ns
    return Heard(times_ns, source.take(count)[:, 0], times_ns, np.ones(count, np.int64))


def still_film(pressed: Pressed) -> Heard:
    """What the film said before anything moved, a sample a batch."""
    at_s, force_n = pressed.film(pressed.still)
    times_ns = np.round(at_s * 1e9).astype(np.int64)
    return Heard(times_ns, force_n, times_ns, np.ones(len(at_s), np.int64))
