"""Conformance tests of plug-ins: telepulse's own kinds pass, and each defect is named."""

import itertools
import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from pydantic import ConfigDict
from telepulse_example.board import BoardDecoder, BoardPort, BoardScene
from telepulse_example.damped import Damped, DampedScene
from telepulse_example.sine import Sine, SineScene
from telepulse_example.voice_coil import VoiceCoil, VoiceCoilScene

from display_node.plant.scene import SecondOrderScene, StepperScene
from display_node.prediction.scene import OwnPredictorScene
from protocol.wire.description import Channel
from sensing_node.sources.synthetic import SyntheticScene
from sensing_node.sources.wrist import WristScene
from telepulse.testing import (
    ConformanceError,
    check_actuator,
    check_entry_point,
    check_predictor,
    check_sensor,
    check_source,
)
from telepulse.testing import predictor as predictor_module
from tests.support.refusals import refusal_of

SINE: Mapping[str, Any] = {"kind": "sine"}
BOARD: Mapping[str, Any] = {"kind": "sine_board", "rate": "1 kHz", "unit": "N"}
DAMPED: Mapping[str, Any] = {"kind": "damped"}
COIL: Mapping[str, Any] = {"kind": "voice_coil"}


@pytest.mark.parametrize(
    ("section", "keys"),
    [
        (SyntheticScene, {"kind": "synthetic", "noise": "1 mN", "heart_rate_variability": "4 %"}),
        (WristScene, {"kind": "wrist", "noise": "1 mN"}),
    ],
)
def test_own_sources_conform(section: Any, keys: Mapping[str, Any]) -> None:
    check_source(section, keys)
    check_entry_point(section)


def test_own_actuators_and_predictors_conform(monkeypatch: pytest.MonkeyPatch) -> None:
    check_actuator(SecondOrderScene, {"kind": "second_order"})
    check_actuator(StepperScene, {"kind": "stepper", "rotor_resonance": "100 Hz"})
    monkeypatch.setattr(predictor_module, "LEARNS_S", 3.0)
    for kind in ("hold", "stack"):
        check_predictor(OwnPredictorScene, {"kind": kind})


def broken_source(**changes: Any) -> type[SineScene]:
    """Return the kind "sine" with a source of other attributes."""
    source = type("Broken", (Sine,), changes)
    return type("BrokenScene", (SineScene,), {"build": lambda self, context: source(self)})


def slow_take(source: Sine, count: int) -> Any:
    time.sleep(count * source.period_ns * 1e-9)
    return Sine.take(source, count)


def altered(change: Callable[[Any], Any]) -> dict[str, Any]:
    return {"take": lambda self, count: change(Sine.take(self, count))}


def with_nan(values: Any) -> Any:
    values[7:8] = math.nan
    return values


random_numbers = np.random.default_rng(1)
SOURCES: dict[str, dict[str, Any]] = {
    "take(5000) did not return within 0.5 s: it waits": {"take": slow_take},
    "sample 7 of channel 'sine' is nan: each must be finite": altered(with_nan),
    "a sample reaches 4e+08 N": altered(lambda values: values * 1e9),
    "returns the shape (5000, 2), not (5000, 1)": altered(lambda values: np.tile(values, 2)),
    "samples from 0 on differ when they are taken 1 at once": altered(
        lambda values: values + random_numbers.normal(size=values.shape)
    ),
    "no channel is a force": {"channels": (Channel("announce", "mV"),)},
}


@pytest.mark.parametrize("message", SOURCES)
def test_a_sources_defect_is_named(message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if "it waits" in message:
        monkeypatch.setattr("telepulse.testing.source.WITHIN_S", 0.5)
    with pytest.raises(ConformanceError) as caught:
        check_source(broken_source(**SOURCES[message]), SINE)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_section_model_is_checked_too() -> None:
    class Thawed(SineScene):
        model_config = ConfigDict(frozen=False)

    with pytest.raises(ConformanceError, match="Thawed is not frozen"):
        check_source(Thawed, SINE)
    with pytest.raises(ConformanceError, match='lacks the field kind: Literal\\["saw"\\]'):
        check_source(SineScene, {"kind": "saw"})
    with pytest.raises(ConformanceError, match=r'as the entry point "sine" in telepulse\.sources'):
        check_entry_point(Thawed)


def broken_sensor(
    port: dict[str, Any] | None = None, decoder: dict[str, Any] | None = None
) -> type[BoardScene]:
    """Return the kind "sine_board" with a port and a decoder of other methods."""
    ports = type("BrokenPort", (BoardPort,), port or {})
    decoders = type("BrokenDecoder", (BoardDecoder,), decoder or {})

    def device(self: BoardScene, folder: object) -> Any:
        return ports(self.rate_hz), decoders(self)

    return type("BrokenScene", (BoardScene,), {"device": device})


def fed(change: Callable[[Any], Any]) -> dict[str, Any]:
    return {"feed": lambda self, data: [change(b) for b in BoardDecoder.feed(self, data)]}


def leave_thread(port: BoardPort) -> None:
    threading.Thread(target=time.sleep, args=(3,), name="reader", daemon=True).start()


class Forgetful(BoardDecoder):
    """It yields nothing after it was started anew."""

    starts = 0

    def reset(self) -> None:
        self.starts += 1
        BoardDecoder.reset(self)

    def feed(self, packet: tuple[int, int]) -> Any:
        return BoardDecoder.feed(self, packet) if self.starts < 2 else []


backwards = itertools.count(1_000_000_000, -1_000_000)
SENSORS: dict[str, tuple[dict[str, Any] | None, dict[str, Any] | None]] = {
    "read did not return within 0.3 s: it waits": ({"read": lambda self: time.sleep(0.5)}, None),
    "close leaves a thread that runs on: reader": ({"close": leave_thread}, None),
    "feed returns a value that is not finite": (
        None,
        fed(lambda block: block._replace(values=block.values * math.inf)),
    ),
    "the device's time goes back, from": (
        None,
        fed(lambda block: block._replace(device_ns=next(backwards), restarted=False)),
    ),
    "no sample came after the device was gone": (
        None,
        {"reset": Forgetful.reset, "feed": Forgetful.feed, "starts": 0},
    ),
    "samples a second came, and the table's rate is 1000 Hz": (
        None,
        fed(lambda block: block._replace(values=np.repeat(block.values, 2, axis=0))),
    ),
}


@pytest.mark.parametrize("message", SENSORS)
def test_a_sensors_defect_is_named(message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Short only where it is awaited: a busy machine delays the threads of the other cases too.
    if "it waits" in message:
        monkeypatch.setattr("telepulse.testing.sensor.READ_WITHIN_S", 0.3)
    if "was gone" in message:
        monkeypatch.setattr("telepulse.testing.sensor.RECOVERS_WITHIN_S", 3.0)
    if "runs on" in message:
        monkeypatch.setattr("telepulse.testing.conformance.ENDS_WITHIN_S", 0.2)
    with pytest.raises(ConformanceError) as caught:
        check_sensor(broken_sensor(*SENSORS[message]), BOARD, seconds=0.5)
    assert message in str(caught.value)


class Aliased(Damped):
    """It keeps the caller's lists, which later have other samples."""

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        self._lists = (times_ns, values)

    def predict(self, sampled_ns: int) -> float:
        return self._lists[1][-1] if hasattr(self, "_lists") else 0.0


class Drifting(Damped):
    """Each prediction changes the next."""

    def predict(self, sampled_ns: int) -> float:
        self._calls = getattr(self, "_calls", -1) + 1
        return 0.1 * self._calls


PREDICTORS: dict[str, Any] = {
    "it looks ahead: its predictions follow the lists": Aliased,
    "predict changes later predictions": Drifting,
    "the prediction 1 ms after the newest sample is nan": {
        "predict": lambda self, t: math.nan if t else 0.0
    },
}


@pytest.mark.parametrize("message", PREDICTORS)
def test_a_predictors_defect_is_named(message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predictor_module, "LEARNS_S", 0.25)
    change = PREDICTORS[message]
    made = type("Broken", (Damped,), change) if isinstance(change, dict) else change

    class Scene(DampedScene):
        def build(self, tick_ns: int, count: int) -> Any:
            return [made(self.fades_ns) for _ in range(count)]

    assert message in refusal_of(ConformanceError, check_predictor, Scene, DAMPED)


class Lagging(VoiceCoil):
    """Its force follows an inner state that STATE does not name."""

    def __init__(self, scene: VoiceCoilScene, tick_s: float) -> None:
        super().__init__(scene, tick_s)
        self._inner_n = 0.0

    def drift(self) -> float:
        return self._inner_n - self.force_n

    def step(self, output: float) -> float:
        self.force_n = self._inner_n + self.response * output
        self._inner_n = 0.5 * self._inner_n + 0.1 * output
        return self.force_n


class Saturating(VoiceCoil):
    """Its response depends on the output, which `response` does not show."""

    def step(self, output: float) -> float:
        return super().step(min(output, 0.5))


ACTUATORS: dict[str, Any] = {
    "it has state that STATE (force_n) does not name": Lagging,
    "the controller would rely on the latter": Saturating,
    "the force after 1 steps is nan": {"step": lambda self, output: math.nan},
}


@pytest.mark.parametrize("message", ACTUATORS)
def test_an_actuators_defect_is_named(message: str) -> None:
    change = ACTUATORS[message]
    made = type("Broken", (VoiceCoil,), change) if isinstance(change, dict) else change

    class Scene(VoiceCoilScene):
        def build(self, tick_s: float) -> Any:
            return made(self, tick_s)

    assert message in refusal_of(ConformanceError, check_actuator, Scene, COIL)
