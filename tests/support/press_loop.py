"""The whole loop of the press in virtual time: finger, set-points, link, probe, wrist and back.

Both sides are the nodes' own classes, joined by encoded messages over the link's model. The finger
and the wrist are models. Playout is a fixed perceived delay.
"""

import heapq
import itertools
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from display_node.press.finger import PressingFinger
from display_node.press.finger_press import FingerPress, PressLimits
from display_node.scoring.beats import BeatAnalysis
from protocol.tissue import PASCALS_PER_MMHG
from protocol.wire.messages import (
    Frame,
    ProbeReport,
    SetPoint,
    channel_samples,
    decode_control,
    decode_frame,
    encode_control,
    encode_frame,
)
from sensing_node.press.set_points import SetPointServer
from sensing_node.sources.wrist import Wrist, WristScene
from telepulse.simulation.link_model import MessageLink
from telepulse.simulation.link_scene import LinkScene

TICK_NS: Final = 1_000_000
BATCH: Final = 5
# The sensing clock is ahead by this, so that a confusion of the two clocks shows at once.
AHEAD_NS: Final = 3_600_000_000_000
SESSION, PRESS = 7, 11
# Samples are played this much later than the link delays them on average, besides the jitter.
SPARE_NS: Final = 15_000_000
STALE_NS: Final = 60_000_000

Meant = Callable[[float], float]
"""Force in N that the hand means at a time in s."""
Intruder = Callable[[int], list[SetPoint]]
"""Further set-points that arrive at the wrist at a time in ns, for faults."""


class PressTrace(NamedTuple):
    """The course of a run, one value a tick. Forces in N, times in s.

    truth_n: the pulse above its foot that the wrist would have given with the present press, at the
    instant that is felt.
    """

    time_s: NDArray[np.float64]
    meant_n: NDArray[np.float64]
    press_n: NDArray[np.float64]
    set_point_n: NDArray[np.float64]
    hold_down_n: NDArray[np.float64]
    pulse_n: NDArray[np.float64]
    truth_n: NDArray[np.float64]
    yielded_m: NDArray[np.float64]
    loop_gain: NDArray[np.float64]


class ArterialPulse(NamedTuple):
    """Arterial pressure of a modelled wrist, and the rhythm of its heart and of respiration."""

    systolic_mmhg: float
    diastolic_mmhg: float
    heart_rate_hz: float = 1.25
    variability: float = 0.0
    respiration: float = 0.0
    respiration_rate_hz: float = 0.25


# That of the scene `press`, regular and without respiration.
OWN_PULSE: Final = ArterialPulse(120.0, 80.0)


@dataclass(frozen=True, slots=True)
class PressSetting:
    """Setting of a run.

    tissue, finger: stiffness over that of the models. pulse_share: share of the rendered pulse in
    the press sensor's reading. connections: TCP connections over which the set-points take turns.
    copies: connections over which each set-point is sent. batch: samples in a frame, a multiple of
    5. paths: TCP connections of the frames, of which the first copies are used. open_loop: forces
    at the wrist that replace the received set-points. later_ns: further perceived delay, by which a
    step meets another part of the beat. pulse: of the wrist.
    """

    link: LinkScene
    tissue: float = 1.0
    finger: float = 1.0
    pulse_share: float = 1.0
    seed: int = 1
    connections: int = 1
    copies: int = 1
    batch: int = BATCH
    paths: int = 1
    open_loop: Meant | None = None
    later_ns: int = 0
    pulse: ArterialPulse = OWN_PULSE


class PressLoop:
    """One run of the press in virtual time.

    arrived_ns: time at which the last set-point arrived at the wrist.
    """

    def __init__(self, setting: PressSetting, meant: Meant, intruder: Intruder | None = None):
        self._setting, self._meant, self._intruder = setting, meant, intruder
        scene, link = wrist_scene(setting), setting.link
        self.wrist = Wrist(scene)
        self.server = SetPointServer(SESSION, self.wrist)
        self.finger = PressingFinger(300.0 * setting.finger, setting.pulse_share, seed=setting.seed)
        self.press = FingerPress(PressLimits(), PRESS)
        seeds = range(setting.seed, setting.seed + setting.connections + 1)
        self._down, *self._up = (MessageLink(link, seed) for seed in seeds)
        self._tcp = link.transport == "tcp"
        self._delay_ns = link.delay_ns + 4 * link.jitter_ns + SPARE_NS + setting.later_ns
        self._delay_ns += (setting.batch - BATCH) * TICK_NS
        self._round_trip_ns = 2 * (link.delay_ns + 4 * link.jitter_ns)
        if self._tcp:
            # A lost packet arrives 1.25 round trips later.
            self._delay_ns += 5 * link.delay_ns // 2
        self._beats = BeatAnalysis()
        self._times_ns: list[int] = []
        self._relative: list[float] = []
        self._events: list[tuple[int, int, Callable[[bytes, int], None], bytes]] = []
        self._order = itertools.count()
        self._sample = 0
        self._unsent: list[NDArray[np.float32]] = []
        self._pressures_pa: list[float] = []
        self._rendered_n = 0.0
        self.arrived_ns = 0

    def run(self, seconds: float) -> PressTrace:
        """Run for a time, and return its course."""
        rows = [self._tick(number * TICK_NS) for number in range(round(seconds * 1e9) // TICK_NS)]
        return PressTrace(*np.array(rows).T)

    def _tick(self, now_ns: int) -> tuple[float, ...]:
        if now_ns % (BATCH * TICK_NS) == 0:
            self._sense(now_ns)
        events = self._events
        while events and events[0][0] <= now_ns:
            at_ns, _, event, data = heapq.heappop(events)
            event(data, at_ns)
        press, meant_n = self.press, self._meant(now_ns * 1e-9)
        relative, alive = self._play(now_ns + AHEAD_NS - self._delay_ns)
        self._rendered_n = press.felt_n(relative)
        yielded_m = press.tick(now_ns)
        reading_n = self.finger.step(meant_n, yielded_m, self._rendered_n, TICK_NS * 1e-9)
        press.read(reading_n, self._rendered_n, now_ns)
        clock_ns = now_ns + AHEAD_NS
        wanted = press.request(SESSION, clock_ns, self._round_trip_ns, now_ns, alive)
        if wanted is not None:
            for copy in range(self._setting.copies):
                place = wanted.number * self._setting.copies + copy
                link = self._up[place % len(self._up)]
                self._send(link, now_ns, self._answer, encode_control(wanted))
        return (
            now_ns * 1e-9,
            meant_n,
            self.finger.press_n,
            press.sender.set_point_n,
            self.wrist.force_n,
            self._rendered_n,
            self._truth_n(now_ns),
            yielded_m,
            press.loop_gain,
        )

    def _truth_n(self, now_ns: int) -> float:
        number = (now_ns - self._delay_ns) // TICK_NS + BATCH - 1
        if number < 0:
            return 0.0
        return self.wrist.artery.pulse_n(self._pressures_pa[number], self.finger.press_n)

    def _sense(self, now_ns: int) -> None:
        """Take the samples of the last 5 ms at the wrist, and send those of a complete frame."""
        for message in self._intruder(now_ns) if self._intruder is not None else ():
            self.server.answer(message, now_ns + AHEAD_NS)
        if self._setting.open_loop is not None:
            self.wrist.press(self._setting.open_loop(now_ns * 1e-9))
        self._unsent.append(self.wrist.take(BATCH).astype(np.float32))
        self._pressures_pa += self.wrist.pressures_pa
        batch = self._setting.batch
        if len(self._unsent) * BATCH < batch:
            return
        values = np.concatenate(self._unsent)
        self._unsent.clear()
        first_ns = now_ns + AHEAD_NS - (batch - 1) * TICK_NS
        frame = encode_frame(Frame(SESSION, self._sample, first_ns, TICK_NS, values))
        self._sample += batch
        paths = range(self._setting.paths)
        arrivals = [self._down.data_arrival_ns(now_ns, len(frame), path) for path in paths]
        if arrived := [at_ns for at_ns in arrivals if at_ns is not None]:
            self._schedule(min(arrived), self._receive, frame)

    def _receive(self, data: bytes, now_ns: int) -> None:
        frame = decode_frame(data)
        pulse, cell = frame.samples_of(0), frame.samples_of(1)
        hold_downs_n = self.press.observe(pulse.times_ns, pulse.forces_n, cell.forces_n)
        relative = list(map(self.press.relative, pulse.forces_n, hold_downs_n, pulse.times_ns))
        samples = channel_samples(frame.first_sample, frame.t_first_ns, TICK_NS, relative)
        for beat in self._beats.observe(samples):
            self.press.take_beat(beat.interval_s, beat.good)
        times_ns = self._times_ns
        place = bisect_right(times_ns, samples.times_ns[0])
        times_ns[place:place] = samples.times_ns
        self._relative[place:place] = relative
        if len(times_ns) > 8_192:
            del times_ns[:4_096], self._relative[:4_096]

    def _play(self, instant_ns: int) -> tuple[float, bool]:
        """Return the relative pulse at an instant, and whether it is fresh."""
        place = bisect_right(self._times_ns, instant_ns) - 1
        if place < 0:
            return 0.0, False
        alive = instant_ns - self._times_ns[place] <= STALE_NS
        return self._relative[place] if alive else 0.0, alive

    def _answer(self, data: bytes, now_ns: int) -> None:
        message = decode_control(data)
        assert isinstance(message, SetPoint)
        if self._setting.open_loop is not None:
            return
        self.arrived_ns = now_ns
        reply = self.server.answer(message, now_ns + AHEAD_NS)
        self._send(self._down, now_ns, self._report, encode_control(reply))

    def _report(self, data: bytes, now_ns: int) -> None:
        message = decode_control(data)
        assert isinstance(message, ProbeReport)
        self.press.take(message)

    def _send(
        self, link: MessageLink, now_ns: int, deliver: Callable[[bytes, int], None], data: bytes
    ) -> None:
        """Send a control message; over datagrams it may be lost."""
        if self._tcp:
            self._schedule(link.control_arrival_ns(now_ns, len(data)), deliver, data)
        elif (arrival_ns := link.data_arrival_ns(now_ns, len(data))) is not None:
            self._schedule(arrival_ns, deliver, data)

    def _schedule(self, at_ns: int, event: Callable[[bytes, int], None], data: bytes) -> None:
        heapq.heappush(self._events, (at_ns, next(self._order), event, data))


def wrist_scene(setting: PressSetting) -> WristScene:
    """Return the wrist of a setting."""
    length_m, pulse = 1.2e-3 / setting.tissue, setting.pulse
    return WristScene.model_validate(
        {
            "kind": "wrist",
            "pulse": {
                "kind": "synthetic",
                "seed": setting.seed,
                "heart_rate": f"{pulse.heart_rate_hz} Hz",
                "heart_rate_variability": pulse.variability,
                "respiration": pulse.respiration,
                "respiration_rate": f"{pulse.respiration_rate_hz} Hz",
            },
            "systolic": f"{pulse.systolic_mmhg * PASCALS_PER_MMHG} Pa",
            "diastolic": f"{pulse.diastolic_mmhg * PASCALS_PER_MMHG} Pa",
            "length": f"{length_m} m",
            "noise": "0.5 mN",
        }
    )


def link_of(round_trip_s: float, transport: str = "datagram", loss: float = 0.01) -> LinkScene:
    """Return a link with this round trip, 10 % of jitter, and loss."""
    delay_s = round_trip_s / 2
    return LinkScene.model_validate(
        {
            "delay": f"{delay_s} s",
            "jitter": f"{0.1 * delay_s} s",
            "loss": loss,
            "transport": transport,
        }
    )
