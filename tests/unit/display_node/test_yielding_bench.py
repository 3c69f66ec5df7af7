"""A real bench under a hand that presses, in virtual time: the tip yields as the model does."""

import dataclasses
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from display_node.plant.contact import ContactLaw
from display_node.plant.scene import StepperScene
from display_node.press.scene import PressScene
from display_node.scene import DisplayScene
from protocol.wire.description import Channel
from protocol.wire.messages import Frame, encode_frame
from pulse_sensors.samples import SampleBlock
from tests.support.sender import AHEAD_NS, MS, display_scene
from tests.support.streams import synthetic
from tests.support.threaded_bench import ThreadedBench

LIMIT_N = 2.5
# Hand of 300 N/m that follows a tip with a time constant of 0.1 s.
HAND_N_S_PER_M = 30.0
HOLD_DOWN_N = 1.0


class Hand(ContactLaw):
    """A finger whose hand moves until it presses with the force that it means."""

    def __init__(self, law: ContactLaw) -> None:
        self._law = law
        self.place_m = self.force_n = 0.0
        self.means_n: float | None = None

    def position(self, force_n: float) -> float:
        return self._law.position(force_n)

    def force(self, position_m: float) -> float:
        """Return the force at a position, one call a millisecond."""
        self.force_n = self._law.force(position_m - self.place_m)
        if self.means_n is not None:
            self.place_m += (self.force_n - self.means_n) / HAND_N_S_PER_M * 1e-3
        return self.force_n


class PressSensor:
    """The sensor behind the tip; reads_n: what it reads instead of the force."""

    def __init__(self, bench: "PressedBench") -> None:
        self._bench, self._rng = bench, np.random.default_rng(1)
        self._taken_ms = bench.world.now_ns // MS
        self.reads_n: float | None = None
        self.rejected: Counter[str] = Counter()

    def poll(self) -> list[SampleBlock]:
        now_ms = self._bench.world.now_ns // MS
        count, self._taken_ms = now_ms - self._taken_ms, now_ms
        if count <= 0:
            return []
        read_n = self._bench.hand.force_n if self.reads_n is None else self.reads_n
        values = read_n + 2e-3 * self._rng.standard_normal((count, 1))
        return [SampleBlock(values, 0, (now_ms - count + 1) * MS, (now_ms + 1) * MS)]


@dataclass
class PressedBench(ThreadedBench):
    """The bench of scene tmcl_bench with a press sensor, under a hand; tip_m: one a millisecond."""

    @property
    def hand(self) -> Hand:
        assert isinstance(self.law, Hand)
        return self.law

    @property
    def tip_m(self) -> NDArray[np.float64]:
        return np.array([moment.tip_m for moment in self.moments])

    def frame_of(self, now_ns: int, forces_n: list[float]) -> bytes:
        """Return a frame of film and load cell."""
        sender, count = self.sender, len(forces_n)
        pulse = np.array(forces_n, np.float32)
        values = np.column_stack([pulse, pulse + HOLD_DOWN_N]).astype("<f4")
        period_ns, first_ns = sender.stream.period_ns, now_ns + AHEAD_NS
        first_ns -= (count - 1) * period_ns
        frame = Frame(sender.session, sender.sent, first_ns, period_ns, values)
        sender.sent += count
        return encode_frame(frame)

    def connect(self) -> None:
        super().connect()
        press = self.display.press
        assert press is not None
        press.use(PressSensor(self))


@pytest.fixture
def pressed(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., PressedBench]]:
    """Return a function that starts a bench; blind: its film drifts."""
    benches = ExitStack()

    def build(touch_mm: float = 8, blind: bool = False) -> PressedBench:
        sensor = {"kind": "serial", "port": "x", "framing": "binary", "rate": "1 kHz", "unit": "N"}
        press = PressScene.model_validate({"film_reads_press": not blind, "sensor": sensor})
        plain = display_scene("tmcl_bench")
        assert plain.drive is not None
        assert isinstance(plain.actuator, StepperScene)
        drive = plain.drive.model_copy(update={"touch_m": touch_mm * 1e-3})
        scene: DisplayScene = plain.model_copy(update={"press": press, "drive": drive})
        source = synthetic(preset="paper", rate="1 kHz", peak_to_peak="0.3 N", preload="0 N")
        pulse_n = source.take(12_000)[:, 0].tolist()
        hand = Hand(plain.actuator.contact(scene.layer.layer()))
        bench = PressedBench(scene, lambda ms: float(pulse_n[ms % len(pulse_n)]), law=hand)
        stream, channels = bench.sender.stream, (Channel("pulse"), Channel("hold-down"))
        bench.sender.stream = dataclasses.replace(stream, channels=channels)
        monkeypatch.setattr(bench.sender, "frame_of", bench.frame_of)
        benches.enter_context(bench)
        bench.start()
        bench.moments.clear()
        if blind:
            # A charge amplifier with a time constant of 2 s.
            level = [0.0]

            def film_n(force_n: float) -> float:
                level[0] += (force_n - level[0]) * 1e-3 / 2.0
                return force_n - level[0]

            monkeypatch.setattr(bench.motor.injector, "film_n", film_n)
        return bench

    with benches:
        yield build


@pytest.mark.parametrize("blind", [False, True])
def test_the_tip_yields_to_a_hand_by_the_model_of_the_tissue(
    pressed: Callable[..., PressedBench], blind: bool
) -> None:
    bench = pressed(blind=blind)
    for means_n, seconds in ((0.3, 3), (1.0, 4), (0.5, 4)):
        bench.hand.means_n = means_n
        bench.run(1_000 * seconds)
        assert bench.display.press is not None
        model_m = bench.display.press.yielded_m
        assert model_m > 0.5e-3
        # Over some beats; the tip moves by the pulse about this place.
        assert -bench.tip_m[-1_600:].mean() == pytest.approx(model_m, abs=0.25e-3)
    assert not bench.display.fade.faults
    forces_n = [moment.force_n for moment in bench.moments]
    assert max(forces_n) < LIMIT_N
    # The pulse is felt around the press.
    assert np.ptp(forces_n[5_400:7_000]) > 0.1


def test_the_tip_yields_no_further_than_its_travel(pressed: Callable[..., PressedBench]) -> None:
    bench = pressed(touch_mm=3)
    bench.hand.means_n = 1.0
    bench.run(4_000)
    assert not bench.display.fade.faults
    assert bench.display.press is not None
    assert 0.3e-3 < -bench.tip_m[-1_600:].mean() < 0.7 * bench.display.press.yielded_m
    # The finger lies at least 1 mm before home, so that the tip can leave it.
    assert bench.tip_m.min() > -2.2e-3


def test_after_a_fault_the_tip_leaves_a_finger_that_has_followed_it(
    pressed: Callable[..., PressedBench],
) -> None:
    bench = pressed()
    bench.hand.means_n = 1.0
    bench.run(3_000)
    # The hand rests where it is.
    bench.hand.means_n = None
    bench.film.silent = True
    bench.run(1_000)
    assert list(map(str, bench.display.fade.faults)) == ["film: feedback lost"]
    assert bench.hand.force_n == 0
    assert bench.drive.status().withdrawal is not None
    assert bench.tip_m[-1] > -8e-3


def test_a_press_sensor_that_reads_a_press_that_is_not_there_presses_nobody(
    pressed: Callable[..., PressedBench],
) -> None:
    bench = pressed()
    press = bench.display.press
    assert press is not None
    sensor = PressSensor(bench)
    sensor.reads_n = 2.0
    press.use(sensor)
    bench.run(3_000)
    assert max(moment.force_n for moment in bench.moments) < 0.5
