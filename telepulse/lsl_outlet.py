"""Outlet of a display's telemetry as Lab Streaming Layer (LSL) streams.

Messages that cannot be forwarded are counted. Labels, units and types of the streams are in
`desc/channels/channel`, the maker in `desc/acquisition`, as LabRecorder and XDF need them
(https://github.com/sccn/xdf/wiki/Meta-Data).
"""

import itertools
import logging
import math
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from protocol.config.quantities import count_text
from protocol.security.link_keys import ClientKeys
from protocol.summary.fields import contactors_of
from protocol.wire.description import StreamDescription
from protocol.wire.messages import Frame
from pulse_sensors import library
from telepulse.sample_queue import FrameReorderer
from telepulse.telemetry.client import TelemetryClient
from telepulse.telemetry.decoder import Entry, PassiveReceiver
from telepulse.telemetry.schema import EVENT, FRAME, STATUS, TICK

logger = logging.getLogger(__name__)

# Number of comparisons of the two clocks; the one that took the least time is used.
TRIES = 9
# Ticks of several contactors that wait for a status; there is one for every 200 ticks.
MOST_WAITING = 2_000


class LslTime:
    """Mapping of Unix times of one run of a display to LSL's local clock, in s.

    Its error is the difference between the clocks of this host and the display's host.
    """

    def __init__(self, local_clock: Callable[[], float]) -> None:
        self._local_clock = local_clock
        self.begin()

    def begin(self) -> None:
        """Compare both clocks, when a run of the display begins."""
        readings = [
            (self._local_clock(), time.time_ns(), self._local_clock()) for _ in range(TRIES)
        ]
        before_s, self._unix_ns, after_s = min(
            readings, key=lambda reading: reading[2] - reading[0]
        )
        self._lsl_s = (before_s + after_s) / 2

    def at(self, unix_ns: int) -> float:
        """Return LSL's time of a Unix time, in s."""
        return self._lsl_s + (unix_ns - self._unix_ns) * 1e-9


class LslStreams:
    """LSL outlets of one display; a stream with the same description keeps its outlet.

    address: the telemetry's address, which makes source ids unique. Raises SourceError without the
    pylsl package, or the library that it loads.
    """

    def __init__(self, address: str) -> None:
        self._lsl = library("pylsl", "an LSL outlet")
        self._address = address
        self._wrist: Any = None
        self._finger: Any = None
        self._contactors: Sequence[str] = ()
        self._pressed = False
        self._description: StreamDescription | None = None
        self._events = self._open("events", "Markers", 0.0, "string", [("event", "")])

    def local_clock(self) -> float:
        """Return LSL's clock, in s."""
        return float(self._lsl.local_clock())

    def describe(self, description: StreamDescription) -> bool:
        """Set the stream's description; return whether it differs from the one before."""
        if description == self._description:
            return False
        self._description = description
        channels = [(channel.name, channel.unit) for channel in description.channels]
        kind = "float32" if description.bytes_per_sample == 4 else "double64"
        facts = {"stream": description.name, "group_delay_ns": str(description.group_delay_ns)}
        self._wrist = self._open("wrist", "Force", description.rate_hz, kind, channels, **facts)
        return True

    def push_wrist(self, values: "np.ndarray[Any, Any]", times_s: list[float]) -> None:
        """Push samples of all channels with their times."""
        self._wrist.push_chunk(values, times_s)

    def push_finger(
        self,
        contactors: Sequence[str],
        forces_n: Sequence[list[float]],
        times_s: list[float],
        pressed: bool = False,
    ) -> None:
        """Push target and felt force of each contactor at ticks, with the ticks' times.

        contactors: their names; "" of an only one. pressed: press and hold-down follow.
        """
        if self._finger is None or (contactors, pressed) != (self._contactors, self._pressed):
            self._contactors, self._pressed = contactors, pressed
            # Irregular rate: a real loop's ticks come late, and missed ones are left out.
            channels = [
                (f"{force} {name}".rstrip(), "N")
                for name in contactors
                for force in ("target", "felt")
            ]
            channels += [("press", "N"), ("hold-down", "N")] if pressed else []
            self._finger = self._open("finger", "Force", 0.0, "double64", channels)
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
        **facts: str,
    ) -> Any:
        name, source = f"telepulse {part}", f"telepulse {self._address} {part}"
        info = self._lsl.StreamInfo(name, content, len(channels), rate_hz, kind, source)
        labels = info.desc().append_child("channels")
        for label, unit in channels:
            channel = labels.append_child("channel")
            for key, value in (("label", label), ("unit", unit), ("type", content)):
                channel.append_child_value(key, value)
        maker = info.desc().append_child("acquisition")
        for fact, value in {"manufacturer": "telepulse", **facts}.items():
            maker.append_child_value(fact, value)
        return self._lsl.StreamOutlet(info)


class LslForwarder:
    """Forwarder of one display; passed: counts of samples, ticks and events passed to LSL."""

    def __init__(self, outlets: LslStreams) -> None:
        self._outlets = outlets
        self._time = LslTime(outlets.local_clock)
        self._entries = PassiveReceiver()
        self._session: int | None = None
        self._reorderer = FrameReorderer()
        self._lost = 0
        # Ticks of several contactors, whose names the next status has.
        self._waiting: list[Entry] = []
        self._contactors: list[str] = [""]
        self.passed: Counter[str] = Counter()

    @property
    def lost(self) -> int:
        """Number of samples of the wrist that did not arrive in time."""
        return self._lost + self._reorderer.lost

    def take(self, entries: list[Entry]) -> None:
        """Forward the entries of one telemetry message."""
        ticks = [entry for entry in entries if entry.topic == TICK]
        if ticks:
            self._waiting += ticks
            self._entries.play(ticks[-1].fields["instant_ns"])
        for entry in entries:
            if entry.topic == STATUS:
                self._contactors = list(contactors_of(entry.fields["summary"]))
        self._push_ticks()
        for entry in entries:
            if entry.topic == EVENT:
                self._take_event(entry)
            elif entry.topic not in (TICK, STATUS):
                frame = self._entries.take(entry.topic, entry.fields)
                if frame is not None:
                    self._take_frame(frame, entry)
                elif entry.topic == FRAME and not self._entries.receiver.clock.ready:
                    self.passed["frames too early"] += 1

    def finish(self) -> None:
        """Forward the frames that are held back, and count the ticks that are."""
        self._flush_frames()
        self.passed["ticks without names"] += len(self._waiting)
        self._waiting = []

    def _flush_frames(self) -> None:
        for frame in self._reorderer.flush():
            self._push(frame)
        self._lost, self._reorderer = self.lost, FrameReorderer()

    def _push_ticks(self) -> None:
        """Forward the ticks that have as many contactors as the last status names."""
        count = len(self._contactors)
        states = [(entry.fields, *entry.fields.get("others", ())) for entry in self._waiting]
        fit = [len(each) == count for each in states]
        if any(fit):
            fitting = list(itertools.compress(states, fit))
            forces_n = [
                # An unknown felt force is sent as NaN.
                [x for each in tick for x in (each["target_n"], each.get("felt_n", math.nan))]
                for tick in fitting
            ]
            pressed = "press_n" in fitting[-1][0]
            if pressed:
                for row, (state, *_) in zip(forces_n, fitting, strict=True):
                    row += (state.get(key, math.nan) for key in ("press_n", "hold_down_n"))
            times_s = [
                self._time.at(entry.t_ns) for entry in itertools.compress(self._waiting, fit)
            ]
            self._outlets.push_finger(self._contactors, forces_n, times_s, pressed)
            self.passed["ticks"] += len(forces_n)
        unfit = [entry for entry, fits in zip(self._waiting, fit, strict=True) if not fits]
        self._waiting = unfit[-MOST_WAITING:]
        self.passed["ticks without names"] += len(unfit) - len(self._waiting)

    def _take_frame(self, frame: Frame, entry: Entry) -> None:
        if frame.session != self._session:
            self._flush_frames()
            self._session = frame.session
            description = self._entries.receiver.description
            assert description is not None
            verb = "begins" if self._outlets.describe(description) else "continues"
            logger.info(f"{description.name!a} {verb}: session {frame.session}")
        arrived_ns = entry.fields["arrived_ns"]
        # From the sensing clock to the display's, and to Unix time.
        ahead_ns = self._entries.receiver.clock.offset_ns(arrived_ns) + arrived_ns - entry.t_ns
        in_unix_time = frame._replace(t_first_ns=frame.t_first_ns - ahead_ns)
        for each in self._reorderer.take(in_unix_time, arrived_ns):
            self._push(each)

    def _push(self, frame: Frame) -> None:
        count = len(frame.values)
        times_s = [self._time.at(frame.t_first_ns + at * frame.period_ns) for at in range(count)]
        self._outlets.push_wrist(np.ascontiguousarray(frame.values), times_s)
        self.passed["samples"] += count

    def _take_event(self, entry: Entry) -> None:
        name = entry.fields["name"]
        if name == "begin":
            # A display that was restarted has another clock.
            self.finish()
            self._time.begin()
            self._entries, self._session = PassiveReceiver(), None
        self._outlets.push_event(f"{name}: {entry.fields['message']}", self._time.at(entry.t_ns))
        self.passed["events"] += 1


class LslOutlet:
    """Outlet that runs until the display ends, falls silent or `stop` is called.

    Raises SourceError without LSL, or AddressError.
    """

    def __init__(self, address: str, keys: ClientKeys | None = None) -> None:
        self._address = address
        self._outlets = LslStreams(address)
        self._forwarder = LslForwarder(self._outlets)
        self._client = TelemetryClient(address, keys)
        self._client.subscribe()
        self.stop = self._client.stop

    def run(self, seconds: float | None = None, silence_s: float | None = None) -> bool:
        """Forward until the end; return whether all that the display published arrived.

        `seconds` and `silence_s` are those of `TelemetryClient.follow`.
        """
        try:
            for entries in self._client.follow(self._address, seconds, silence_s):
                self._forwarder.take(entries)
            self._forwarder.finish()
        finally:
            self._outlets.close()
            self._client.close()
        passed, decoder = self._forwarder.passed, self._client.decoder
        if not decoder.started:
            logger.warning(f"{self._address}: no telemetry came; is a display running there?")
            return False
        counts = [count_text(passed[f"{name}s"], name) for name in ("sample", "tick", "event")]
        missing = f"{count_text(self._forwarder.lost, 'sample')} missing"
        if early := passed["frames too early"]:
            missing += f"; {count_text(early, 'frame')} came before the sensing clock was known"
        if unnamed := passed["ticks without names"]:
            missing += f"; {count_text(unnamed, 'tick')} without a status that names the contactors"
        logger.info(f"{self._address}: {', '.join(counts)}; {missing}")
        if decoder.missed:
            missed = ", ".join(f"{n} {name}" for name, n in sorted(decoder.missed.items()))
            logger.warning(f"{self._address}: of the telemetry {missed} were missed")
        return not decoder.missed
