"""Telemetry of a display that plays a sine, as in a recording."""

import math
from dataclasses import asdict
from typing import Any

from protocol.summary.fields import Clock, Loop, PressFigures, RmsErrors, SampleCounts, Summary
from protocol.tactile import ElasticLayer
from telepulse.telemetry.decoder import Entry, without_none
from telepulse.telemetry.schema import EVENT, FRAME, LEVELS, STATUS, STREAM, TICK
from telepulse.view.live import LiveState
from tests.support.recorded_sweeps import SweptWrist

MS = 1_000_000
SECOND_NS = 1000 * MS
# Unix time at which the display's clock is 0; sensing clock minus the display's.
UNIX_NS, AHEAD_NS = 1_700_000_000 * SECOND_NS, 5_000 * SECOND_NS
ONE_WAY_NS, PLAYOUT_NS = 12 * MS, 40 * MS
MEAN_N, SWING_N, BEATS_A_SECOND = 0.3, 0.15, 1.25
BATCH = 5
WRIST = ElasticLayer()
# Twice as stiff: twice the force for the same strain.
FINGER = ElasticLayer(young_modulus_pa=0.1e9)
RATIO = WRIST.strain_per_newton / FINGER.strain_per_newton
SESSION = 7


def pulse_n(t_ns: float) -> float:
    """Return the pulse at the wrist, at an instant of the display's clock."""
    return MEAN_N + SWING_N * math.sin(2 * math.pi * BEATS_A_SECOND * t_ns * 1e-9)


class SimulatedDisplay:
    """A display whose telemetry goes to `live`, tick by tick.

    names: of its contactors. The nth plays channel n, whose pulse is n + 1 times as high.
    """

    def __init__(self, live: LiveState, names: tuple[str, ...] = ("finger",)) -> None:
        self.live, self.names = live, names
        self.at_ns = SECOND_NS
        self.summary: dict[str, Any] = {}
        self.played = 0
        self.linked = True
        self.trusted = False
        self.film_age_ns, self.playout_ns = 0, PLAYOUT_NS
        self.event("begin", "the recording")
        layer = {name: getattr(WRIST, name) for name in WRIST.__slots__}
        channels = {"channels": [{"name": f"of {name}", "unit": "N"} for name in names]}
        self.take(STREAM, self.at_ns, session=SESSION, layer=layer, group_delay_ns=0, **channels)
        self.status("waiting")

    def take(self, topic: str, at_ns: int, **fields: Any) -> None:
        self.live.take(Entry(topic, at_ns + UNIX_NS, fields))

    def event(self, name: str, message: str = "", level: str = "INFO") -> None:
        self.take(EVENT, self.at_ns, name=name, message=message, level=LEVELS[level])

    def status(self, state: str, final: bool = False, **changes: Any) -> None:
        whole = Summary(
            samples=SampleCounts(self.played, self.played, 0, 0, 0, 0),
            clock=Clock(AHEAD_NS / MS, 3.0, 0.05, 0.1, 0),
            force_rmse_n=RmsErrors(2e-3, 3e-3),
            strain_rmse=RmsErrors(*(abs(FINGER.strain(e)) for e in (2e-3, 3e-3))),
            loop=Loop(1000, 0),
        )
        fields = without_none(whole.to_dict() | changes)
        playing = [
            {
                "contactor": name,
                "channel": channel,
                "force_ratio": RATIO,
                "strain_per_newton": FINGER.strain_per_newton,
                "predictor": "ensemble",
                "stale_after_ns": 60 * MS,
                "film_age_ns": self.film_age_ns,
            }
            for channel, name in enumerate(self.names)
        ]
        display = {"state": state, "stream": "sine", "final": final, "playing": playing}
        self.take(STATUS, self.at_ns, **display, summary=fields)

    def frame(self, **changes: Any) -> None:
        """Send the samples of which the last was taken ONE_WAY_NS before now."""
        first_ns = self.at_ns - ONE_WAY_NS - (BATCH - 1) * MS
        fields = {
            "arrived_ns": self.at_ns,
            "session": SESSION,
            "t_first_ns": first_ns + AHEAD_NS,
            "period_ns": MS,
            "channels": len(self.names),
            "force_n": [
                pulse_n(first_ns + i * MS) * (1 + channel)
                for i in range(BATCH)
                for channel in range(len(self.names))
            ],
        }
        self.take(FRAME, self.at_ns, **(fields | changes))

    def go(self, seconds: float, state: str = "playing", **changes: Any) -> None:
        """Run for some seconds: a tick each ms, a frame each 5, a status with changes each 200."""
        playing = state == "playing"
        for _ in range(round(seconds * 1000)):
            self.at_ns += MS
            if self.linked and self.at_ns // MS % BATCH == 0:
                self.frame()
            played_ns = self.at_ns - self.playout_ns
            felt_n = pulse_n(played_ns - self.film_age_ns) * RATIO if playing else 0.0
            others = [{"felt_n": felt_n * (1 + n), "target_n": 0.0} for n in range(len(self.names))]
            self.played += playing
            self.take(
                *(TICK, self.at_ns),
                now_ns=self.at_ns,
                instant_ns=played_ns + AHEAD_NS,
                felt_n=felt_n,
                target_n=felt_n,
                scored=playing,
                trusted=self.trusted,
                **({"others": others[1:]} if len(others) > 1 else {}),
            )
            if self.at_ns // MS % 200 == 0:
                self.status(state, **changes)


def play_sweep(display: SimulatedDisplay, wrist: SweptWrist, press_n: float) -> None:
    """Send the samples of a sweep as the frames of a pressed wrist."""
    channels = [{"name": name, "unit": "N"} for name in ("pulse", "hold-down")]
    display.take(STREAM, display.at_ns, session=8, group_delay_ns=0, channels=channels)
    pressed = PressFigures(press_n=press_n, hold_down_n=press_n, loop_gain=2e-4, probe="pressing")
    display.status("playing", press=asdict(pressed))
    for values in wrist.taken:
        display.at_ns += len(values) * MS
        fields = {
            "arrived_ns": display.at_ns,
            "session": 8,
            "t_first_ns": display.at_ns - ONE_WAY_NS - (len(values) - 1) * MS + AHEAD_NS,
            "period_ns": MS,
            "channels": 2,
            "force_n": values.ravel().tolist(),
        }
        display.take(FRAME, display.at_ns, **fields)
        display.live.now_ns = display.live.frame_ns
