"""Touch over a network: simulate and record runs, read them as arrays, and follow live streams.

The commands are `sensing-node`, `display-node` and `telepulse`. From Python:

>>> import telepulse
>>> run = telepulse.simulate("radial", seconds=5, link="delay=40ms,jitter=10ms")
>>> print(f"{1e3 * run.summary.force_rmse_n.aligned:.0f} mN")
2 mN
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from display_node.scoring.beats import Beat
    from protocol.errors import TelepulseError
    from telepulse.live_stream import LiveStream, connect
    from telepulse.parallel import SweepResults, sweep
    from telepulse.recording.recorded_run import read_recording
    from telepulse.run import ContactorRun, Run, find_beats
    from telepulse.sample_queue import StreamBlock
    from telepulse.scene import Scene, load_scene
    from telepulse.simulation.simulated_run import simulate

# Each name's module, imported when it is used: commands import this package and need none of them.
_MODULES: Final = {
    "Beat": "display_node.scoring.beats",
    "ContactorRun": "telepulse.run",
    "LiveStream": "telepulse.live_stream",
    "Run": "telepulse.run",
    "Scene": "telepulse.scene",
    "StreamBlock": "telepulse.sample_queue",
    "SweepResults": "telepulse.parallel",
    "TelepulseError": "protocol.errors",
    "connect": "telepulse.live_stream",
    "find_beats": "telepulse.run",
    "load_scene": "telepulse.scene",
    "read_recording": "telepulse.recording.recorded_run",
    "simulate": "telepulse.simulation.simulated_run",
    "sweep": "telepulse.parallel",
}
__version__: str
__all__ = [
    "Beat",
    "ContactorRun",
    "LiveStream",
    "Run",
    "Scene",
    "StreamBlock",
    "SweepResults",
    "TelepulseError",
    "connect",
    "find_beats",
    "load_scene",
    "read_recording",
    "simulate",
    "sweep",
]


if not TYPE_CHECKING:  # A type checker would take any name for one of the package.

    def __getattr__(name: str) -> Any:
        """Import a name of `__all__` from its module; look up `__version__`."""
        if name == "__version__":
            return import_module("importlib.metadata").version("telepulse")
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """Return the names that this package offers."""
    own = {name for name in globals() if name.startswith("__")}
    return sorted({*own, "__version__", *__all__})
