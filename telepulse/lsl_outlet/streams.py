"""LSL streams of a display, described as LabRecorder and XDF need them.

Labels, units and types stand in `desc/channels/channel`, the maker in `desc/acquisition`
(the meta-data of XDF, https://github.com/sccn/xdf/wiki/Meta-Data).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from protocol.wire.stream import StreamDescription
from pulse_sensors.extra import library

MANUFACTURER = "telepulse"
FORCE, MARKERS = "Force", "Markers"
FINGER_CHANNELS = ("target", "felt")


class LslStreams:
    """LSL outlets of one display; a stream with the same description keeps its outlet."""

    def __init__(self, address: str) -> None:
        """Open the outlet of events; the telemetry's address makes source ids unique.

        Raises SourceError without the pylsl package, or the library it loads.
        """
        self._lsl = library("pylsl", "an LSL outlet")
        self._address = address
        self._wrist: Any = None
        self._finger: Any = None
        self._description: StreamDescription | None = None
        self._events = self._open("events", MARKERS, 0.0, "string", (("event", ""),), {})

    def local_clock(self) -> float:
        """Return LSL's clock, in s."""
        return float(self._lsl.local_clock())

    def describe(self, description: StreamDescription) -> bool:
        """Set the stream's description; return whether it differs from the one before."""
        if description == self._description:
            return False
        self._description = description
        channels = tuple((channel.name, channel.unit) for channel in description.channels)
        kind = "float32" if description.bytes_per_sample == 4 else "double64"
        facts = {"stream": description.name, "group_delay_ns": str(description.group_delay_ns)}
        self._wrist = self._open("wrist", FORCE, description.rate_hz, kind, channels, facts)
        return True

    def push_wrist(self, values: "np.ndarray[Any, Any]", times_s: Sequence[float]) -> None:
        """Push samples of all channels with their times."""
        self._wrist.push_chunk(values, list(times_s))

    def push_finger(self, forces_n: Sequence[tuple[float, float]], times_s: list[float]) -> None:
        """Push target and felt force of ticks with their times."""
        if self._finger is None:
            # Ticks come at a real loop's pace, with those that were missed left out.
            channels = tuple((name, "N") for name in FINGER_CHANNELS)
            self._finger = self._open("finger", FORCE, 0.0, "double64", channels, {})
        self._finger.push_chunk(np.array(forces_n), times_s)

    def push_event(self, text: str, time_s: float) -> None:
        """Push an event."""
        self._events.push_sample([text], time_s)

    def close(self) -> None:
        """End the streams."""
        self._wrist = self._finger = self._events = None

    def _open(
        self,
        part: str,
        content: str,
        rate_hz: float,
        kind: str,
        channels: Sequence[tuple[str, str]],
        facts: dict[str, str],
    ) -> Any:
        source = f"{MANUFACTURER} {self._address} {part}"
        name = f"{MANUFACTURER} {part}"
        info = self._lsl.StreamInfo(name, content, len(channels), rate_hz, kind, source)
        labels = info.desc().append_child("channels")
        for label, unit in channels:
            channel = labels.append_child("channel")
            channel.append_child_value("label", label)
            channel.append_child_value("unit", unit)
            channel.append_child_value("type", content)
        maker = info.desc().append_child("acquisition")
        maker.append_child_value("manufacturer", MANUFACTURER)
        for fact, value in facts.items():
            maker.append_child_value(fact, value)
        return self._lsl.StreamOutlet(info)
