"""Simulation of a scene into arrays."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from protocol.config.arguments import number, whole_number
from protocol.errors import SceneError
from telepulse.run import Run, RunBuilder, RunTick
from telepulse.scene import DEFAULT_SCENE, Scene, load_scene
from telepulse.simulation.virtual_time import SENSING_CLOCK_AHEAD_NS, Simulation

# A day in s, and the greatest number of a session.
LONGEST_S, MOST_SEED = 86_400, (1 << 63) - 2


def simulate(
    scene: Scene | Path | str = DEFAULT_SCENE,
    seconds: float = 30.0,
    seed: int = 1,
    *,
    sensing: Mapping[str, Any] = {},
    display: Mapping[str, Any] = {},
    link: Mapping[str, Any] | str = {},
) -> Run:
    """Simulate a scene in virtual time: both nodes, and the link between them.

    The same scene and seed give the same run.

    Parameters
    ----------
    scene
        Scene, its file, or the name of one that comes with telepulse.
    seconds
        Length of the stream, in s; at most a day.
    seed
        Seed of the link's delays and losses, a whole number from 0.
    sensing, display, link
        Changes of the scene's sections, as `load_scene` takes them.

    Returns
    -------
    Run
        The arrays have one value for each tick of the display. The force at the wrist is the true
        one, without the noise of the sensing chain.

    Raises
    ------
    ArgumentError
        If an argument is of another type, or out of range.
    SceneError
        If the scene or a change of it is not valid, or its force loop is not stable.
    SourceError
        If the scene's source cannot be read.

    Examples
    --------
    >>> import telepulse
    >>> run = telepulse.simulate("radial", seconds=5, link="delay=40ms,jitter=10ms")
    >>> run.felt_n.shape == run.t_s.shape
    True
    """
    seconds = number("seconds", seconds, 1e-3, LONGEST_S)
    seed = whole_number("seed", seed, 0, MOST_SEED)
    if isinstance(scene, Scene):
        if sensing or display or link:
            raise SceneError("changes of a scene that is loaded already: give them to load_scene")
    else:
        scene = load_scene(scene, sensing=sensing, display=display, link=link)
    builder = RunBuilder()
    simulation = Simulation(scene, seed, take_frame=builder.add_frame)
    node, tick_ns = simulation.display, scene.display.tick_ns
    for state in simulation.ticks(seconds):
        ready, alive = node.receiver.ready, node.state in ("starting", "playing")
        lead_ns = max(contactor.lead_ns for contactor in node.contactors)
        known = node.receiver.buffer.known(tick_ns, 1, 0, state.instant_ns + lead_ns)
        builder.add_tick(
            RunTick(
                state.now_ns,
                state.now_ns + SENSING_CLOCK_AHEAD_NS,
                state.instant_ns if ready and alive else None,
                state.scored,
                alive and not known,
            ),
            [(each.target_n, each.felt_n) for each in node.states],
        )
    playback = [
        contactor.playback(channel)
        for contactor, channel in zip(node.contactors, node.receiver.channels, strict=False)
    ]
    return builder.run(scene.path.stem, playback, simulation.end())
