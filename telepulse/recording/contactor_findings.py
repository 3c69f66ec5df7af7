"""Findings about one contactor of a recorded display: its forces, and the beats of its channel."""

import math
from collections import defaultdict
from typing import Any

import numpy as np

from display_node.scoring.beat_statistics import BeatStatistics
from protocol.wire.messages import Frame
from protocol.wire.stream import StreamDescription
from telepulse.recording.forces import AlignedTick, ForceHistory, Trend


class ContactorFindings:
    """Forces at wrist and finger over a recording, and the beats.

    name: of the contactor; empty before the display's first status. beats: statistics of them.
    trends: interval in ms, height in mN and quality of each beat over the time of the recording.
    """

    def __init__(self) -> None:
        self.name = ""
        self.forces = ForceHistory()
        self.beats = BeatStatistics()
        self.trends: defaultdict[str, Trend] = defaultdict(Trend)

    def begin(self) -> None:
        """Begin another session."""
        self.forces.alignment.begin()
        self.beats.restart()

    def set_playback(self, playing: dict[str, Any]) -> None:
        """Set channel, scale and strain by the display's status."""
        channel, ratio = int(playing["channel"]), float(playing["force_ratio"])
        strain = playing.get("strain_per_newton")
        self.forces.alignment.set_playback(
            channel, ratio, None if strain is None else float(strain)
        )

    def add_frame(
        self, frame: Frame, description: StreamDescription, last_s: float, last_ns: int
    ) -> None:
        """Add a frame; last_s, last_ns: time of its last sample, in the recording and sensed."""
        alignment = self.forces.alignment
        alignment.add_frame(frame, description)
        for beat in self.beats.observe(frame.samples_of(alignment.channel)):
            t_s = np.array([last_s + (beat.onset_ns - last_ns) * 1e-9])
            values = {
                "interval_ms": beat.interval_s * 1e3,
                "height_mn": beat.height_n * 1e3,
                "quality": math.nan if beat.quality is None else beat.quality,
            }
            for name, value in values.items():
                self.trends[name].add(t_s, np.array([value]))

    def add_tick(
        self, t_s: float, sensing_now_ns: int, instant_ns: int, state: dict[str, Any]
    ) -> None:
        """Add a tick at full strength; state: fields of this contactor."""
        felt_n = float(state.get("felt_n", math.nan))
        self.forces.alignment.add_tick(AlignedTick(t_s, sensing_now_ns, instant_ns, felt_n))
