"""The pulse at the wrist before the sensing chain: the reference of a felt force."""

from pathlib import Path

from protocol.wire.messages import Frame
from sensing_node.scene import SensingScene, build_source
from sensing_node.sources.synthetic import SyntheticScene


class ReferenceForce:
    """The true values of the frames of one session, from a second copy of their source.

    The truth is the output of an ideal film at the samples' own times: without mains hum, notch,
    anti-alias filter and ADC. No film measures a static force, so a charge amplifier and its
    hold-down force are part of the truth.
    """

    def __init__(self, scene: SensingScene, folder: Path) -> None:
        """`folder` is the scene file's. Raises SourceError or SceneError."""
        true_scene = _without_losses(scene)
        self._source = None if true_scene == scene else build_source(true_scene, folder)
        self._taken = 0

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


def _without_losses(scene: SensingScene) -> SensingScene:
    source, conditioning = scene.source, scene.conditioning
    if isinstance(source, SyntheticScene):
        source = source.model_copy(update={"hum_n": 0.0})
    if conditioning is not None:
        conditioning = conditioning.without_losses()
    return scene.model_copy(update={"source": source, "conditioning": conditioning})
