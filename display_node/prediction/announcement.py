"""The channel that announces the beats of a stream: its R waves go to the predictor. Pure."""

from dataclasses import replace

from display_node.prediction import Predictor
from display_node.prediction.grid import STEP_NS
from display_node.prediction.r_waves import RWaveDetector
from protocol.summary.fields import AnnounceFigures
from protocol.wire.messages import ChannelSamples

STEP_MS = STEP_NS * 1e-6


class BeatAnnouncement:
    """R waves of one session, given to the predictor of the stream's first played channel."""

    def __init__(self, predictor: Predictor) -> None:
        self._predictor, self._detector = predictor, RWaveDetector()
        self._count = self._used = 0

    def observe(self, samples: ChannelSamples) -> None:
        """Take the samples of a frame, in mV or any other unit."""
        waves = self._detector.observe(samples.times_ns, samples.forces_n)
        if waves:
            self._predictor.announce(waves)
            self._count += len(waves)
            transit = self._predictor.transit
            if transit is not None and transit.reliable:
                self._used += len(waves)

    def figures(self) -> AnnounceFigures:
        """Return the figures of the announcement so far."""
        transit, count = self._predictor.transit, self._count
        figures = AnnounceFigures(count, self._used / count if count else None, self._unused)
        if transit is None or transit.median is None:
            return figures
        transit_ms, deviation_ms = STEP_MS * transit.median, STEP_MS * transit.deviation
        return replace(figures, transit_ms=transit_ms, deviation_ms=deviation_ms)

    @property
    def _unused(self) -> str | None:
        """Why R waves are not used at present; None where they are."""
        transit = self._predictor.transit
        if transit is not None and transit.reliable:
            return None
        if not self._count:
            return "no R wave was found"
        if transit is None:
            return "this predictor uses none"
        if not self._detector.distinct:
            return "its peaks do not stand out as those of an ECG do"
        return "no pulse follows its R waves at a constant time"
