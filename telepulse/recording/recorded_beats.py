"""Beats of a recording, one by one: those of each contactor's channel, as the display finds them.

A beat's times are on the sensing clock; `unix_ns` is that of its onset by the display's clock.
"""

from collections import defaultdict
from collections.abc import Iterator
from typing import Any

from display_node.scoring.beats import Beat, BeatAnalysis
from telepulse.telemetry.decoder import Entry, PassiveReceiver
from telepulse.telemetry.schema import STATUS, TICK


class RecordedBeats:
    """Analysis of the played channels of a recording, entry by entry.

    Until a status has named the contactors, the first channel is played by one without a name.
    """

    def __init__(self) -> None:
        self._entries = PassiveReceiver()
        self._session: int | None = None
        self._instant_ns: int | None = None
        # Every force is analysed: the first status comes after the first frames.
        self._analyses: defaultdict[int, BeatAnalysis] = defaultdict(BeatAnalysis)
        self._contactors: list[tuple[str, int]] = [("", 0)]

    @property
    def units(self) -> list[str]:
        """Units of the stream's channels; none before its description."""
        description = self._entries.receiver.description
        return [] if description is None else [channel.unit for channel in description.channels]

    def take(self, entry: Entry) -> Iterator[list[Any]]:
        """Yield the beats that an entry completes, each as a row of the table.

        Raises KeyError, ValueError or TypeError for fields that are not those of an entry.
        """
        fields = entry.fields
        if entry.topic == TICK:
            self._instant_ns = fields["instant_ns"]
        elif entry.topic == STATUS:
            # The buffer is emptied this often: each tick would double the time of an export.
            if self._instant_ns is not None:
                self._entries.play(self._instant_ns)
            if playing := fields.get("playing"):
                self._contactors = [(str(p["contactor"]), int(p["channel"])) for p in playing]
        elif (frame := self._entries.take(entry.topic, fields)) is not None:
            receiver = self._entries.receiver
            if frame.session != self._session:
                self._session = frame.session
                self._analyses.clear()
            unix_ahead_ns = entry.t_ns - receiver.clock.remote_ns(fields["arrived_ns"])
            found = {
                channel: self._analyses[channel].observe(frame.samples_of(channel))
                for channel, unit in enumerate(self.units)
                if unit == "N"
            }
            for name, channel in self._contactors:
                for beat in found.get(channel, ()):
                    yield [
                        name,
                        channel,
                        frame.session,
                        *_cells(beat),
                        beat.onset_ns + unix_ahead_ns,
                    ]


def _cells(beat: Beat) -> list[Any]:
    """Return the columns from `onset_ns` to `quality`."""
    return [
        beat.onset_ns,
        beat.peak_ns,
        beat.notch_ns,
        beat.foot_n,
        beat.height_n,
        beat.upstroke_s * 1e3,
        beat.interval_s * 1e3,
        60 / beat.interval_s,
        beat.quality,
    ]
