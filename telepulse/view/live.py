"""State of a display over the last minutes: telemetry in rolling tables, thinned to curves. Pure.

All times are Unix time by the display's clock. Samples of the wrist are mapped to it by the clock
offset of the last status.
"""

import math
from collections import deque

import numpy as np

from display_node.reception.receiver import FUTURE_NS, OLDEST_NS
from display_node.scoring.beats import BeatAnalysis
from display_node.scoring.pressed_beats import SteadyAnalysis
from protocol.summary.fields import contactors_of
from protocol.wire.description import HOLD_DOWN
from protocol.wire.messages import channel_samples
from telepulse.telemetry.decoder import MARK_EVENT, Entry, Fields
from telepulse.telemetry.schema import EVENT, FRAME, LEVELS, STATUS, STREAM, TICK
from telepulse.view.depth import DepthState
from telepulse.view.plots import INFORMATION, MARK
from telepulse.view.tables import FAST_ROWS, SLOW_ROWS, RollingTable, Times

MS = 1_000_000
# The plots of a minute show so many events; a list shows the last ones of them.
EVENTS, LISTED_EVENTS = 200, 12
KINDS = {LEVELS["WARNING"]: "warning", LEVELS["ERROR"]: "error"}
# A status may name hundreds of contactors; a page has room for these.
MAX_CONTACTORS = 8
SAMPLE_COUNTS = "played", "predicted", "lost", "late"
# Columns of the ticks of a contactor.
FELT_N, DELAY_NS, PREDICTOR_ERROR_N, TARGET_N = range(4)
TICK_FIELDS = "felt_n", "predictor_error_n", "target_n"
# Time over which the plotted shares of lost and late samples are taken.
LOSS_NS = 1_000_000_000


class ContactorState:
    """State of one contactor in a run of a display.

    Columns of ticks: felt_n (NaN where unknown), playout delay in ns (NaN where the pulse is not
    felt at full strength), predictor_error_n (NaN without one), target_n. wrist: force in N of
    samples. beats: at the onset of each, force at the foot and height in N, and quality (NaN where
    unknown), as `analysis` finds them. playing: the signal that is played, as in the last status;
    empty before.
    """

    def __init__(self) -> None:
        self.ticks = RollingTable(4, FAST_ROWS)
        self.wrist = RollingTable(1, FAST_ROWS)
        self.beats = RollingTable(3, SLOW_ROWS)
        self.playing: Fields = {}
        self.analysis = BeatAnalysis()

    def add_tick(self, t_ns: int, fields: Fields, delay_ns: float) -> None:
        """Add a tick, with this contactor's forces."""
        felt_n, error_n, target_n = (fields.get(key, math.nan) for key in TICK_FIELDS)
        self.ticks.add(t_ns, felt_n, delay_ns, error_n, target_n)

    def add_frame(self, t_ns: Times, fields: Fields) -> None:
        """Add the played channel's samples of a frame, at Unix times; copies are skipped."""
        channel, channels = self.playing.get("channel", 0), fields["channels"]
        period_ns, first_ns = fields["period_ns"], int(t_ns[0])
        # Copies come over other paths.
        if channel >= channels or self.wrist.has(first_ns, period_ns // 2):
            return
        values = fields["force_n"][channel::channels]
        self.wrist.insert(t_ns, np.array(values)[:, np.newaxis])
        samples = channel_samples(0, fields["t_first_ns"], period_ns, values)
        for beat in self.analysis.observe(samples):
            quality = math.nan if beat.quality is None else beat.quality
            onset_ns = beat.onset_ns - samples.times_ns[0] + first_ns
            self.beats.add(onset_ns, beat.foot_n, beat.height_n, quality)


class LiveState:
    """State of one run of a display; another run resets it.

    contactors: of the display, at least one and at most `MAX_CONTACTORS`. beyond: number of further
    ones. channels: names of the stream's channels. delays: one-way delay in ms of frames. statuses:
    clock offset and its uncertainty in ms, samples lost and late in %; then, since the
    run's start: refused messages, seconds at any limit, refused telemetry readers; the finger's
    press in N. summary: the figures of the last status, which are of the whole run; the page
    computes the errors that it shows over its window instead. depth: the beats by hold-down, of a
    wrist that is pressed.

    trusted: whether the predictor was trusted at the last tick. stream_ended: the sensing node has
    ended the stream. display_ended: the display has sent its final status. stepped_ns,
    telemetry_missed_ns: Unix time of the last clock step, and of the last telemetry that was
    missed; −∞ before any.
    """

    def __init__(self) -> None:
        takers = (self._tick, self._frame, self._status, self._stream, self._event)
        self._take = dict(zip((TICK, FRAME, STATUS, STREAM, EVENT), takers, strict=True))
        # Unix time in ns, id of the kind among `plots.EVENT_LINES`, and text of each.
        self.events: deque[tuple[int, str, str]] = deque(maxlen=EVENTS)
        self._begin()

    def _begin(self) -> None:
        self.contactors = [ContactorState()]
        self.beyond = 0
        self.delays = RollingTable(1, FAST_ROWS)
        self.statuses = RollingTable(8, SLOW_ROWS)
        self.depth = DepthState()
        # Numbers of samples so far, at each status: played, predicted, lost and late.
        self._samples = RollingTable(len(SAMPLE_COUNTS), SLOW_ROWS)
        self._offset_ns: int | None = None
        self._group_delay_ns = 0
        self.trusted = False
        self._session: int | None = None
        self.now_ns = self.frame_ns = 0
        self.stepped_ns = self.telemetry_missed_ns = -math.inf
        self.state, self.stream = "", ""
        self.channels: list[str] = []
        self.summary: Fields = {}
        self.stream_ended = self.display_ended = False

    def missing(self, span_ns: int) -> tuple[float, float]:
        """Return the percentages lost and late of the samples that were due in the last `span_ns`.

        NaN where none was due. The time ends at the newest status, and begins at one, or where the
        telemetry does.
        """
        t_ns, counts = self._samples.since(0)[1:]
        if not len(t_ns):
            return math.nan, math.nan
        begin = max(int(np.searchsorted(t_ns, t_ns[-1] - span_ns, "right")) - 1, 0)
        grown = counts[-1] - counts[begin]
        due = float(grown.sum())
        if due <= 0:
            return math.nan, math.nan
        # A lost sample that arrives after all becomes a predicted or a late one.
        *_, lost, late = np.maximum(100 * grown / due, 0.0)
        return float(lost), float(late)

    @property
    def pressing(self) -> bool:
        """True where the finger's press is part of the felt force, or a sweep presses."""
        return "press_n" in self.summary.get("press", {})

    @property
    def names(self) -> list[str]:
        """Names of the contactors, in their order; of an only one, an empty text."""
        if len(self.contactors) == 1:
            return [""]
        return [each.playing["contactor"] for each in self.contactors]

    def contactor(self, number: int) -> ContactorState:
        """Return the contactor of a number, or the first one where the display has fewer."""
        return self.contactors[number if number < len(self.contactors) else 0]

    def take(self, entry: Entry) -> None:
        """Process a message of the display, or an event."""
        if take := self._take.get(entry.topic):
            take(entry)

    def _tick(self, entry: Entry) -> None:
        fields = entry.fields
        if entry.t_ns < self.now_ns:
            return
        self.now_ns = entry.t_ns
        delay_ns = math.nan
        if fields["scored"] and self._offset_ns is not None:
            delay_ns = fields["now_ns"] + self._offset_ns - fields["instant_ns"]
        self.trusted = bool(fields.get("trusted"))
        # Their numbers may differ in the telemetry of another program.
        states = fields, *fields.get("others", ())
        for contactor, state in zip(self.contactors, states, strict=False):
            contactor.add_tick(entry.t_ns, state, delay_ns)

    def _frame(self, entry: Entry) -> None:
        fields, offset_ns = entry.fields, self._offset_ns
        if fields["session"] != self._session:
            return
        self.frame_ns, self.stream_ended = entry.t_ns, False
        count = len(fields["force_n"]) // fields["channels"]
        if offset_ns is None or not count or not self.contactors[0].playing:
            return
        unix_ns, period_ns = entry.t_ns - fields["arrived_ns"], fields["period_ns"]
        sampled_ns = fields["t_first_ns"] - offset_ns + unix_ns
        one_way_ns = entry.t_ns - sampled_ns - (count - 1) * period_ns
        # The display refuses frames that are further off.
        if not -FUTURE_NS < one_way_ns < OLDEST_NS:
            return
        self.delays.add(entry.t_ns, one_way_ns / MS)
        t_ns = sampled_ns - self._group_delay_ns + period_ns * np.arange(count)
        for contactor in self.contactors:
            contactor.add_frame(t_ns, fields)
        played = self.contactors[0].playing["channel"]
        if HOLD_DOWN in self.channels and played < fields["channels"] == len(self.channels):
            values = np.reshape(fields["force_n"], (count, -1))
            cell_n, pulse_n = values[:, self.channels.index(HOLD_DOWN)], values[:, played]
            self.depth.add_frame(t_ns, fields["t_first_ns"], period_ns, pulse_n, cell_n - pulse_n)

    def _status(self, entry: Entry) -> None:
        fields = entry.fields
        self.state, self.stream = fields["state"], fields["stream"]
        self.display_ended, self.summary = fields["final"], fields["summary"]
        clock = self.summary["clock"]
        if "offset_ms" in clock:
            self._offset_ns = round(clock["offset_ms"] * MS)
        self._follow(fields.get("playing", []))
        at_ns = max(self.now_ns, entry.t_ns)
        self._samples.add(at_ns, *(self.summary["samples"].get(key, 0) for key in SAMPLE_COUNTS))
        self.statuses.add(
            at_ns,
            *(clock.get(name, math.nan) for name in ("offset_ms", "uncertainty_ms")),
            *self.missing(LOSS_NS),
            sum(self.summary["rejected"].values()),
            sum(
                limit.get("seconds", 0.0)
                for figures in contactors_of(self.summary).values()
                for limit in figures["limited"].values()
            ),
            sum(self.summary.get("rejected_readers", {}).values()),
            self.summary.get("press", {}).get("press_n", math.nan),
        )

    def _follow(self, playing: list[Fields]) -> None:
        """Take what each contactor plays; before the stream is known this is empty."""
        if not playing:
            return
        shown = playing[:MAX_CONTACTORS]
        self.beyond = len(playing) - len(shown)
        more = len(shown) - len(self.contactors)
        self.contactors = self.contactors[: len(shown)] + [ContactorState() for _ in range(more)]
        for contactor, signal in zip(self.contactors, shown, strict=True):
            contactor.playing = signal

    def _stream(self, entry: Entry) -> None:
        fields = entry.fields
        if fields["session"] != self._session:
            # The clock and the pulse of another session may be others.
            for contactor in self.contactors:
                contactor.analysis = BeatAnalysis()
            self.depth.analysis = SteadyAnalysis()
        self._session, self.stream_ended = fields["session"], False
        self.channels = [channel["name"] for channel in fields.get("channels", ())]
        self._group_delay_ns = fields["group_delay_ns"]

    def _event(self, entry: Entry) -> None:
        name = entry.fields["name"]
        if name == "begin":
            self._begin()
        elif name == "end of stream":
            self.stream_ended = True
        elif name == "clock step":
            self.stepped_ns = entry.t_ns
        elif name == "missed":
            self.telemetry_missed_ns = entry.t_ns
        text = entry.fields["message"]
        kind = MARK if name == MARK_EVENT else KINDS.get(entry.fields["level"], INFORMATION)
        self.events.append((entry.t_ns, kind, f"{name}: {text}"))
