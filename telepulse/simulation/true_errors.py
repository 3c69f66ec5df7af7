"""Errors of the felt force against the true pulse, for programs that have both ends."""

from collections.abc import Iterable
from pathlib import Path

from display_node.scoring.tracking_error import Floats, Times, TrackingError
from protocol.summary.fields import Summary, with_contactors
from protocol.tactile import matching_force_ratio
from protocol.wire.description import StreamDescription
from protocol.wire.messages import Frame
from sensing_node.scene import SensingScene, build_source
from sensing_node.sources.source import SampleSource
from telepulse.scene import Scene


class TrueForce:
    """The true values of the frames of one session, from a second copy of their source.

    The truth is the output of an ideal film at the samples' own times: without mains hum, notch,
    anti-alias filter and ADC. No film measures a static force. So the charge amplifier, and the
    constant preload that stands in for the static force, are part of the truth.
    """

    def __init__(self, scene: SensingScene, folder: Path) -> None:
        """`folder` is the scene file's. Raises SourceError or SceneError."""
        self._source: SampleSource | None = None
        self._taken = 0
        # What a live sensor sends is the truth that there is.
        if scene.sensor is not None:
            return
        source, conditioning = scene.modelled.ideal(), scene.conditioning
        if conditioning is not None:
            conditioning = conditioning.ideal_film()
        true_scene = scene.model_copy(update={"source": source, "conditioning": conditioning})
        if true_scene != scene:
            self._source = build_source(true_scene, folder)

    def of(self, frame: Frame) -> Frame:
        """Return the frame with the true values; the frame itself where the chain is ideal.

        Frames come in order; some may be missing. Raises ValueError for one that comes late.
        """
        if self._source is None:
            return frame
        missed = frame.first_sample - self._taken
        if missed < 0:
            raise ValueError(f"sample {frame.first_sample} comes after {self._taken - 1}")
        values = self._source.take(missed + len(frame.values))[missed:]
        self._taken += missed + len(values)
        return frame._replace(values=values)


class TrueErrors:
    """Errors of each contactor against the true pulse of one session.

    They have the keys and labels of the display's own, against the received pulse, and replace
    them in the summary of a demo or a simulation: the finger is to feel the wrist, not the link.
    Where a finger presses back there are none: the felt pulse depends on its press as well.
    """

    def __init__(self, scene: Scene, stream: StreamDescription, real_benches: bool) -> None:
        """Begin a session; real_benches: whether the scene's drives and films are used.

        Raises SourceError, SceneError or WireError.
        """
        self._true_force = TrueForce(scene.sensing, scene.path.parent)
        # Of each contactor: number of its channel, force at the finger per force at the wrist.
        self._compared: list[tuple[int, float, TrackingError]] = []
        for each in scene.display.contactors:
            channel, layer = stream.find_force(each.channel), each.layer.layer()
            film_age_ns = each.film.latency_ns if real_benches and each.drive is not None else 0
            error = TrackingError(layer.strain_per_newton)
            error.begin_session(film_age_ns)
            if scene.display.press is None:
                ratio = matching_force_ratio(stream.layer, layer)
                self._compared.append((channel, ratio, error))

    def add_sent(self, frame: Frame) -> Frame:
        """Add a frame as it was sent; return it with the true values."""
        true_frame = self._true_force.of(frame)
        for channel, force_ratio, error in self._compared:
            error.add_samples(true_frame.samples_of(channel), force_ratio)
        return true_frame

    def add_felt(
        self, now_ns: Times, sensing_ns: Times, instant_ns: Times, forces_n: Iterable[Floats]
    ) -> None:
        """Add ticks at full strength, as `TrackingError` does; forces_n: felt by each contactor."""
        for (*_, error), felt_n in zip(self._compared, forces_n, strict=bool(self._compared)):
            error.add_output(now_ns, sensing_ns, instant_ns, felt_n)

    def finish(self, display: Summary) -> Summary:
        """Return a display's summary with these errors instead of its own."""
        figures = dict[str, Summary]()
        own = display.of_each_contactor().items()
        for (*_, error), (name, each) in zip(self._compared, own, strict=bool(self._compared)):
            error.finish()
            figures[name] = error.add_to(each, display.loop)
        return with_contactors(display, figures) if figures else display
