"""Reception in a display: session, clock, jitter buffer, delay estimate.

Messages and their arrival times are the input, requests to the sensing node the output. A message
that cannot be used is counted under its cause. Pure: no sockets.
"""

from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from display_node.reception.jitter_buffer import JitterBuffer, SampleAccount
from display_node.reception.link_delay import DelayEstimator
from display_node.reception.playout_clock import JUMP_NS
from protocol.clock.estimator import READY_AFTER, ClockEstimator, ClockExchange
from protocol.errors import VersionError, WireError
from protocol.histogram import Histogram
from protocol.summary.fields import Clock, FrameCounts, OneWayDelay, Summary
from protocol.wire import messages as wire
from protocol.wire.description import StreamDescription

HELLO_EVERY_NS: Final = 250_000_000
# The first READY_AFTER clock requests are sent at once, since nothing is played before the clock is
# known. The rest of the first minute uses the fast interval. A still shorter one would let TCP send
# requests and replies in bunches, which biases the offset.
CLOCK_FAST_NS: Final = 20_000_000
CLOCK_FAST_COUNT: Final = 3_000
CLOCK_EVERY_NS: Final = 50_000_000
# Number of unanswered requests that are remembered: of 10 s, in which TCP repeats what was lost
# over a round trip of 2 s.
MAX_OPEN_REQUESTS: Final = 512
SILENT_AFTER_NS: Final = 1_000_000_000
FUTURE_NS: Final = 1_000_000_000
OLDEST_NS: Final = 60_000_000_000
# Wait after the last sample's instant for late samples. If the last sample itself is missing, the
# wait covers the time for which the sensing node stays to deliver it.
GRACE_NS: Final = 500_000_000
LAST_GRACE_NS: Final = 3_500_000_000


class Receiver:
    """The stream of one sensing node, through its sessions.

    Parameters
    ----------
    channels
        The channels of the stream that are buffered: names, or numbers from 0. Of none, the first
        force.

    Attributes
    ----------
    session, description
        Those of the present session; None before its welcome.
    channel_numbers
        The numbers of the buffered channels in its stream; empty before.
    clock, buffer, link_delay
        Its sensing clock, its samples, and the delay that its link requires. Each session begins
        them anew, a jump of the clock the last two: read them here, and keep none of them.
    paths
        Greatest number of connections so far that deliver frames. With more than one, a repeated
        frame counts as a copy and not as refused.
    resets
        Number of new sessions and of clock jumps. At each, everything learnt from earlier samples
        is discarded.
    clock_steps
        Number of clock steps in all sessions so far.
    take_probe
        Takes answers to set-points; without it they are refused.
    false_report
        Description of the first report of the probe that cannot be true, or "".
    other_version
        Description of the first refused message of another version, or "".
    ready
        True when playing can start: the stream, its clock and its usual delay are known.
    frame
        The newest frame that was accepted; None before any.
    announcement
        Samples of the newest frame's channel that announces the beats; None without such a channel.
    one_way_delay_ms
        Time from a frame's last sample to its arrival, in ms.
    """

    def __init__(
        self, name: str, channels: Sequence[int | str], late_target: float, paths: int = 1
    ) -> None:
        self._name, self.paths = name, paths
        self._selected, self._late_target = channels, late_target
        self.channel_numbers: list[int] = []
        self._announcing: int | None = None
        self.frame: wire.FlatFrame | None = None
        self.announcement: wire.ChannelSamples | None = None
        self._closed = SampleAccount()
        self._closed_accounts: list[SampleAccount] = []
        self._next_hello_ns = self._next_clock_ns = 0
        # Nothing is requested before this time, unless a control message or a refusal comes.
        self._quiet_until_ns = 0
        self._hello_due = False
        self._clock_requests = 0
        # Times of sending of the requests that may still be answered, oldest first.
        self._open_requests_ns: deque[int] = deque(maxlen=MAX_OPEN_REQUESTS)
        self._received_ns = 0
        self.copies = 0
        self.rejected: Counter[str] = Counter()
        self.take_probe: Callable[[wire.ProbeReport], None] | None = None
        self.other_version = self.false_report = ""
        self.one_way_delay_ms = Histogram(0.1, 20_000)
        self.sessions = self.resets = self.clock_steps = 0
        self.session: int | None = None
        self.ready = False
        self.description: StreamDescription | None = None
        self.clock = ClockEstimator()
        self.link_delay = DelayEstimator(late_target)
        self.buffer = JitterBuffer()
        self._last_bye: wire.Bye | None = None

    def on_frame(self, data: bytes, now_ns: int) -> list[wire.ChannelSamples] | None:
        """Take a data message; return the samples of each channel if it is new and valid."""
        try:
            return self._accept(wire.decode_flat_frame(data), now_ns)
        except WireError as error:
            self._quiet_until_ns = 0
            if error.cause == "duplicate" and self.paths > 1:
                self.copies += 1
            else:
                self._refuse(error)
            return None

    def on_control(self, data: bytes, now_ns: int) -> None:
        """Take a control message."""
        self._quiet_until_ns = 0
        try:
            message = wire.decode_control(data)
            self._take(message, now_ns)
        except WireError as error:
            self._refuse(error)

    def _refuse(self, error: WireError) -> None:
        self.rejected[error.cause] += 1
        if isinstance(error, VersionError):
            self.other_version = self.other_version or str(error)
        if error.cause == "false_report":
            self.false_report = self.false_report or str(error)

    @property
    def accepts_frames(self) -> bool:
        """True when frames can be used: the stream's description and its clock are known."""
        return self.session is not None and self.clock.ready

    def silent(self, now_ns: int) -> bool:
        """Return whether no valid message has come for a second."""
        return now_ns - self._received_ns > SILENT_AFTER_NS

    def live(self, sampled_ns: int, sensing_now_ns: int, stale_after_ns: int) -> bool:
        """Return whether the stream is not stale when a sample of `sampled_ns` is played.

        With a small perceived delay the newest sample is older than `sampled_ns` even when it is on
        time. So the age of the newest sample counts only from the link's delay on.
        """
        newest_ns, delay_ns = self.buffer.newest_ns, self.link_delay.delay_ns
        if newest_ns is None or delay_ns is None:
            return False
        return min(sampled_ns, sensing_now_ns - delay_ns) <= newest_ns + stale_after_ns

    def introduce(self) -> None:
        """Send hello with the next requests, because control has a new connection."""
        self._hello_due = True
        self._next_hello_ns = self._quiet_until_ns = 0

    def requests(self, now_ns: int) -> list[wire.ControlMessage]:
        """Return the messages to send to the sensing node now: hello, clock request, final bye."""
        wanted: list[wire.ControlMessage] = []
        if now_ns < self._quiet_until_ns:
            return wanted
        silent = self.silent(now_ns)
        lost = self.session is None or silent or self._hello_due
        if lost and now_ns >= self._next_hello_ns:
            self._next_hello_ns = now_ns + HELLO_EVERY_NS
            self._hello_due = False
            wanted.append(wire.Hello(self._name))
        if self.session is not None and not silent and now_ns >= self._next_clock_ns:
            fast = self._clock_requests < CLOCK_FAST_COUNT
            self._clock_requests += 1
            if self._clock_requests >= READY_AFTER:
                self._next_clock_ns = now_ns + (CLOCK_FAST_NS if fast else CLOCK_EVERY_NS)
            self.expect_reply(now_ns)
            wanted.append(wire.ClockRequest(now_ns))
        if self._last_bye is not None and self.buffer.complete:
            wanted.append(self._last_bye)
            self._last_bye = None
        if not lost and self._last_bye is None:
            self._quiet_until_ns = min(self._next_clock_ns, self._received_ns + SILENT_AFTER_NS)
        return wanted

    def leave(self) -> wire.Bye | None:
        """Return the bye of a display that ends before its stream; None if none is waited for."""
        if self.session is None or (self.buffer.ended and self._last_bye is None):
            return None
        return wire.Bye(self.session, self.account().sent)

    def expect_reply(self, t1_ns: int) -> None:
        """Accept one reply to a clock request of the time `t1_ns`."""
        self._open_requests_ns.append(t1_ns)

    def account(self) -> SampleAccount:
        """Return the account of all samples of all sessions so far."""
        return self._closed + self.buffer.account()

    def accounts(self) -> list[SampleAccount]:
        """Return the account of each contactor, where the buffer keeps them."""
        present = self.buffer.accounts()
        closed = self._closed_accounts or [SampleAccount()] * len(present)
        return [before + now for before, now in zip(closed, present, strict=True)]

    @property
    def frames(self) -> tuple[int, int]:
        """Number of frames received, and of those that came after a newer one."""
        return self.buffer.frames, self.buffer.reordered

    def summary(self, now_ns: int) -> Summary:
        """Return the summary's figures of reception: samples, frames, delay and clock."""
        account, delay, clock = self.account(), self.one_way_delay_ms, self.clock
        return Summary(
            samples=replace(account.counts(), before_joining=account.before_joining),
            frames=FrameCounts(*self.frames, self.copies),
            one_way_delay_ms=OneWayDelay(**delay.quantiles(p50=0.5, p99=0.99), max=delay.maximum),
            clock=Clock(
                clock.offset_ns(now_ns) * 1e-6 if clock.ready else None,
                clock.skew_ppm if clock.ready else None,
                clock.uncertainty_ns(now_ns) * 1e-6 if clock.ready else None,
                clock.asymmetry_bound_ns * 1e-6 if clock.ready else None,
                self.clock_steps,
            ),
        )

    def over(self, now_ns: int, playout_delay_ns: int) -> bool:
        """Return whether the session has ended, and no more samples of it are awaited."""
        if not self.buffer.ended:
            return False
        end_ns = self.buffer.end_ns
        if end_ns is None:
            return True
        grace_ns = GRACE_NS if self.buffer.complete else LAST_GRACE_NS
        return self.clock.remote_ns(now_ns) > end_ns + playout_delay_ns + grace_ns

    def _accept(self, frame: wire.FlatFrame, now_ns: int) -> list[wire.ChannelSamples]:
        """Check a frame against its session and put it into the buffer. Raises WireError."""
        description = self.description
        if description is None:
            raise WireError("before_welcome", "a frame before the stream's description")
        session, first_sample, times_ns, period_ns, channel_count, width, _, forces_n = frame
        if session != self.session:
            self._hello_due = True
            raise WireError("session", "a frame of another session")
        if (
            channel_count != len(description.channels)
            or len(forces_n) > description.batch * channel_count
            or width != description.bytes_per_sample
            or not description.period_ns <= 2 * period_ns <= 4 * description.period_ns
        ):
            raise WireError("mismatch", "a frame does not match the stream's description")
        if not self.clock.ready:
            raise WireError("before_clock", "a frame before the sensing clock is known")
        last_ns = times_ns[-1]
        sensing_now_ns = self.clock.remote_ns(now_ns)
        if not -OLDEST_NS < last_ns - sensing_now_ns < FUTURE_NS:
            raise WireError("timestamp", "a frame's time is not near the present")
        columns = []
        for number in self.channel_numbers:
            columns.append(list(forces_n[number::channel_count]))
        self.buffer.put(first_sample, period_ns, times_ns, columns)
        # What follows does not delay the samples.
        self.frame = frame
        samples = [
            wire.ChannelSamples(first_sample, period_ns, times_ns, column) for column in columns
        ]
        if self._announcing is not None:
            announced = list(forces_n[self._announcing :: channel_count])
            self.announcement = samples[0]._replace(forces_n=announced)
        if self._last_bye is not None:
            # The answer to it may have waited for this frame.
            self._quiet_until_ns = 0
        self._received_ns = now_ns
        self.clock.add_one_way(last_ns, now_ns)
        self.link_delay.observe(sensing_now_ns - times_ns[0], now_ns)
        self.ready = self.ready or self.link_delay.settled
        self.one_way_delay_ms.add((sensing_now_ns - last_ns) * 1e-6)
        return samples

    def _take(self, message: wire.ControlMessage, now_ns: int) -> None:
        match message:
            case wire.Welcome(session=session, description=description):
                self._received_ns = now_ns
                if session != self.session:
                    selected = self._selected or [description.first_force]
                    self.channel_numbers = [description.find_force(each) for each in selected]
                    self._announcing, self.announcement = description.announcing, None
                    # Samples, times and clock of two sessions are unrelated.
                    self._restart(JitterBuffer(len(self.channel_numbers)))
                    self.session, self.description = session, description
                    self.sessions += 1
                    self._clock_requests = self._next_clock_ns = 0
                    self.clock, self._last_bye = ClockEstimator(), None
            case wire.ClockReply() if message.session != self.session:
                self._hello_due = True
                raise WireError("session", "a clock reply of another session")
            case wire.ClockReply(t1_ns=t1_ns, t2_ns=t2_ns, t3_ns=t3_ns):
                self._follow_clock(ClockExchange(t1_ns, t2_ns, t3_ns, now_ns))
            case wire.Bye() if message.session != self.session:
                raise WireError("session", "the end of another session")
            case wire.Bye(samples_sent=samples_sent):
                sensing_now_ns = self.clock.remote_ns(now_ns) if self.clock.ready else None
                self.buffer.end(samples_sent, sensing_now_ns)
                self._last_bye = message
                # A stream that is too short for a good delay estimate is played as well.
                self.ready = self.ready or self.buffer.newest_ns is not None
            case wire.ProbeReport() if self.take_probe is not None:
                if message.session != self.session:
                    raise WireError("session", "a probe's report of another session")
                self.take_probe(message)
            case _:
                raise WireError("unexpected", "a message that only displays send")

    def _follow_clock(self, exchange: ClockExchange) -> None:
        """Take a clock reply; after a clock step, begin the stream anew. Raises WireError."""
        if exchange.t1_ns not in self._open_requests_ns:
            raise WireError("unasked", "a clock reply to an unknown or already answered request")
        self._open_requests_ns.remove(exchange.t1_ns)
        clock, now_ns = self.clock, exchange.t4_ns
        steps, expected_ns = clock.steps, clock.remote_ns(now_ns)
        if not clock.add(exchange):
            raise WireError("implausible", "a clock reply before its request")
        if clock.steps != steps:
            self.clock_steps += clock.steps - steps
            self._clock_requests = 0
            jumped = abs(clock.remote_ns(now_ns) - expected_ns) > JUMP_NS
            if jumped and not self.buffer.ended:
                # Let the playout jump as well. Times before and after the jump are not comparable,
                # so waiting samples are dropped.
                self._restart(self.buffer.successor())

    def _restart(self, buffer: JitterBuffer) -> None:
        self._closed, self._closed_accounts = self.account(), self.accounts()
        buffer.frames, buffer.reordered = self.frames
        self.buffer, self.link_delay = buffer, DelayEstimator(self._late_target)
        self.resets += 1
        self.ready = False
