"""Simulation of a scene into arrays, and of a sweep of a modelled wrist, in virtual time."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from display_node.press.set_points import SetPointSender
from display_node.press.sweep import DepthSweep
from protocol.config.arguments import number, whole_number
from protocol.errors import SceneError
from protocol.wire.messages import channel_samples
from sensing_node.press.set_points import SetPointServer
from sensing_node.scene import log_repetition
from sensing_node.sources.source import SampleSource
from telepulse.columns import SessionColumns, TickRow
from telepulse.run import Run, build_run
from telepulse.scene import DEFAULT_SCENE, Scene, load_scene
from telepulse.simulation.virtual_time import SENSING_CLOCK_AHEAD_NS, Simulation

# A day in s, and the greatest number of a session.
LONGEST_S, MOST_SEED = 86_400, (1 << 63) - 2


def simulate(
    scene: Scene | Path | str = DEFAULT_SCENE,
    seconds: float = 30.0,
    seed: int = 1,
    *,
    source: Path | str | None = None,
    channel: str | int | None = None,
    rate: str | None = None,
    preload: str | None = None,
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
    source, channel, rate, preload
        Recorded pulse to play in place of the scene's source, as `load_scene` takes it. What is
        doubtful in it, such as gaps that were filled, is in `summary.notes`.
    sensing, display, link
        Changes of the scene's sections, as `load_scene` takes them.

    Returns
    -------
    Run
        The arrays have one row for each tick of the display. The force at the wrist is the true
        one, without the noise of the sensing chain.

    Raises
    ------
    ArgumentError
        If an argument is of another type, or out of range.
    SceneError
        If the scene or a change of it is not valid, or its force loop is not stable.
    SourceError
        If the source cannot be read, or leaves open which of its signals is the pulse.

    Examples
    --------
    >>> import telepulse
    >>> run = telepulse.simulate("radial", seconds=5, link="delay=40ms,jitter=10ms")
    >>> run.felt_n.shape == run.t_s.shape
    True

    A recorded pulse over the same link:

    >>> run = telepulse.simulate(source="pulse.csv", link="delay=40ms")  # doctest: +SKIP
    """
    seconds = number("seconds", seconds, 1e-3, LONGEST_S)
    seed = whole_number("seed", seed, 0, MOST_SEED)
    if isinstance(scene, Scene):
        if sensing or display or link or (source, channel, rate, preload) != (None,) * 4:
            raise SceneError("changes of a scene that is loaded already: give them to load_scene")
    else:
        scene = load_scene(
            scene,
            source=source,
            channel=channel,
            rate=rate,
            preload=preload,
            sensing=sensing,
            display=display,
            link=link,
        )
    session = SessionColumns()
    simulation = Simulation(scene, seed, take_frame=session.add_frame)
    log_repetition(simulation.source, seconds)
    node = simulation.display
    for state in simulation.ticks(seconds):
        tick = TickRow(
            state.now_ns,
            state.now_ns + SENSING_CLOCK_AHEAD_NS,
            state.instant_ns,
            ready=True,
            playing=state.predicted_ns >= 0,
            full=state.full,
            predicted=state.predicted_ns > 0,
        )
        session.add_tick(tick, [(each.target_n, each.felt_n) for each in node.states])
    session.playing = {
        contactor.name: contactor.playback(channel)
        for contactor, channel in zip(node.contactors, node.receiver.channel_numbers, strict=False)
    }
    return build_run(Path(source or scene.path), [session], simulation.end())


SESSION, PRESS = 7, 11
BATCH: Final = 5
# Slew of the set-points; the probe limits its own as well.
SLEW_N_PER_S: Final = 20.0


def sweep_wrist(wrist: SampleSource, sweep: DepthSweep, most_n: float) -> int:
    """Sweep a wrist until the sweep is over; return the number of samples that it took.

    most_n: limit of the set-points. Raises SceneError for a source that no probe presses.
    """
    if (probe := wrist.pressed) is None:
        raise SceneError("[sensing] source: no probe presses it, so that it cannot be swept")
    server = SetPointServer(SESSION, probe)
    sender = SetPointSender(PRESS, most_n, SLEW_N_PER_S)
    period_ns, taken = wrist.period_ns, 0
    while not sweep.over:
        film, cell = wrist.take(BATCH).T.tolist()
        pulse = channel_samples(taken, taken * period_ns, period_ns, film)
        taken += BATCH
        now_ns = taken * period_ns
        sweep.observe(pulse, [total - part for total, part in zip(cell, film, strict=True)])
        sweep.tick(now_ns, probe.state)
        set_point = sender.due(sweep.press_n, SESSION, now_ns, 0, now_ns)
        if set_point is not None:
            sender.take(server.answer(set_point, now_ns))
    return taken
