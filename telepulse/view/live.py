"""State of a display: its telemetry, as recordings hold it, in rolling windows. Pure.

All times are Unix time on the display's clock: what was sensed stands where the display's clock
stood then, by the offset that its last status told.
"""

import math
from collections import deque
from collections.abc import Callable

import numpy as np

from display_node.receiver import FUTURE_NS, OLDEST_NS
from telepulse.record.heard_fields import Fields
from telepulse.record.schema import EVENT, FRAME, STATUS, STREAM, TICK
from telepulse.record.transcript import Entry
from telepulse.view.rolling import Rolling

MS = 1_000_000
# Rows: a minute and two at 1 kHz.
FAST_ROWS, SLOW_ROWS = 1 << 16, 1 << 11
EVENTS = 12
# Losses are told of so many statuses, a second.
LOSS_STATUSES = 5


class Live:
    """The state of one run of a display; another run begins it afresh.

    ticks: felt_n (NaN where it is unknown), target_n, playout delay in ns (NaN where the pulse is
    not felt at full strength) and predictor_error_n, NaN where there is none.
    wrist: force in N. delays: one-way delay in ms of frames. statuses: clock offset, its
    uncertainty (ms), skew (ppm), samples lost and late (of 100), deadline misses so far,
    refused messages so far, seconds at any limit so far.
    """

    def __init__(self) -> None:
        self._take: dict[str, Callable[[Entry], None]] = {
            TICK: self._tick,
            FRAME: self._frame,
            STATUS: self._status,
            STREAM: self._stream,
            EVENT: self._event,
        }
        self.events: deque[tuple[int, int, str]] = deque(maxlen=EVENTS)
        self._begin()

    def _begin(self) -> None:
        self.ticks = Rolling(4, FAST_ROWS)
        self.wrist = Rolling(1, FAST_ROWS)
        self.delays = Rolling(1, FAST_ROWS)
        self.statuses = Rolling(8, SLOW_ROWS)
        self._samples: deque[Fields] = deque(maxlen=LOSS_STATUSES)
        self._offset_ns: int | None = None
        self._group_delay_ns = 0
        self._playing: Fields | None = None
        self._session: int | None = None
        self.now_ns = self.frame_ns = 0
        self.stepped_ns = self.missed_ns = -math.inf
        self.state, self.stream = "", ""
        self.summary: Fields = {}
        self.over = self.final = False

    def take(self, entry: Entry) -> None:
        """A message of the display's, or what happened."""
        take = self._take.get(entry.topic)
        if take is not None:
            take(entry)

    @property
    def finger_strain_per_newton(self) -> float | None:
        """Strain per newton of the layer under the finger; None while the display knows no
        stream."""
        return None if self._playing is None else float(self._playing["strain_per_newton"])

    @property
    def force_ratio(self) -> float | None:
        """The right force at the finger per force at the wrist: both strains are equal."""
        return None if self._playing is None else float(self._playing["force_ratio"])

    @property
    def wrist_strain_per_newton(self) -> float | None:
        """Strain per newton of the layer at the wrist."""
        finger, ratio = self.finger_strain_per_newton, self.force_ratio
        return None if finger is None or ratio is None else finger * ratio

    @property
    def predictor(self) -> str:
        """The name of the display's predictor, empty while it is not known."""
        return "" if self._playing is None else str(self._playing["predictor"])

    def _tick(self, entry: Entry) -> None:
        fields = entry.fields
        if entry.t_ns < self.now_ns:
            return
        self.now_ns = entry.t_ns
        delay_ns = math.nan
        if fields["scored"] and self._offset_ns is not None:
            delay_ns = fields["now_ns"] + self._offset_ns - fields["instant_ns"]
        error_n = fields.get("predictor_error_n", math.nan)
        felt_n = fields.get("felt_n", math.nan)
        self.ticks.add(entry.t_ns, felt_n, fields["target_n"], delay_ns, error_n)

    def _frame(self, entry: Entry) -> None:
        fields, offset_ns = entry.fields, self._offset_ns
        if fields["session"] != self._session:
            return
        self.frame_ns, self.over = entry.t_ns, False
        if offset_ns is None or self._playing is None:
            return
        values = fields["force_n"][self._playing["channel"] :: fields["channels"]]
        if not values:
            return
        unix_ns, period_ns = entry.t_ns - fields["arrived_ns"], fields["period_ns"]
        sampled_ns = fields["t_first_ns"] - offset_ns + unix_ns
        one_way_ns = entry.t_ns - sampled_ns - (len(values) - 1) * period_ns
        # The display refuses, and counts, what is further off.
        if not -FUTURE_NS < one_way_ns < OLDEST_NS:
            return
        self.delays.add(entry.t_ns, one_way_ns / MS)
        t_ns = sampled_ns - self._group_delay_ns + period_ns * np.arange(len(values))
        # A copy that came over another path is there already.
        if not self.wrist.has(int(t_ns[0]), period_ns // 2):
            self.wrist.insert(t_ns, np.array(values)[:, np.newaxis])

    def _status(self, entry: Entry) -> None:
        fields = entry.fields
        self.state, self.stream = fields["state"], fields["stream"]
        self.final, self.summary = fields["final"], fields["summary"]
        clock = self.summary["clock"]
        if "offset_ms" in clock:
            self._offset_ns = round(clock["offset_ms"] * MS)
        self._playing = fields.get("playing", self._playing)
        self._samples.append(self.summary["samples"])
        lost, late = self._shares()
        self.statuses.add(
            max(self.now_ns, entry.t_ns),
            *(clock.get(name, math.nan) for name in ("offset_ms", "uncertainty_ms", "skew_ppm")),
            *(lost, late),
            self.summary["loop"].get("deadline_misses", 0),
            sum(self.summary["rejected"].values()),
            sum(limit.get("seconds", 0.0) for limit in self.summary["limited"].values()),
        )

    def _shares(self) -> tuple[float, float]:
        """Return how many of 100 samples that were due in the last second were lost, and how many
        late."""
        old, new = self._samples[0], self._samples[-1]
        grown = {name: new.get(name, 0) - old.get(name, 0) for name in ("played", "lost", "late")}
        due = sum(grown.values())
        if due <= 0:
            return math.nan, math.nan
        # One that comes after all is late, and lost no more.
        return max(0.0, 100 * grown["lost"] / due), max(0.0, 100 * grown["late"] / due)

    def _stream(self, entry: Entry) -> None:
        fields = entry.fields
        self._session, self.over = fields["session"], False
        self._group_delay_ns = fields["group_delay_ns"]

    def _event(self, entry: Entry) -> None:
        name = entry.fields["name"]
        if name == "begin":
            self._begin()
        elif name == "end of stream":
            self.over = True
        elif name == "clock step":
            self.stepped_ns = entry.t_ns
        elif name == "missed":
            self.missed_ns = entry.t_ns
        # It was written for recordings.
        text = entry.fields["message"]
        text = text.replace("the recorder", "this page").replace("the recording", "this page")
        self.events.append((entry.t_ns, entry.fields["level"], f"{name}: {text}"))
