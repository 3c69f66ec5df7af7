"""Conformance tests of plug-ins: telepulse's own kinds pass, and each defect is named."""

import itertools
import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np
import pytest
from pydantic import ConfigDict
from telepulse_example.board import BoardDecoder, BoardPort, BoardScene
from telepulse_example.damped import Damped, DampedScene
from telepulse_example.sine import Sine, SineScene
from telepulse_example.voice_coil import VoiceCoil, VoiceCoilScene

from display_node.plant.scene import SecondOrderScene, StepperScene
from display_node.prediction.scene import OwnPredictorScene
from protocol.wire.stream import Channel
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


def ending_take(source: Sine, count: int) -> Any:
    left = max(0, min(count, 100 - source._taken))
    return Sine.take(source, left if source._taken != 100 else 5)


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
    "take(5000) returns the shape (5000,), not (5000, 1)": altered(lambda values: values[:, 0]),
    "returns the shape (5000, 2), not (5000, 1)": altered(lambda values: np.tile(values, 2)),
    "take returns list, no array": altered(lambda values: values.tolist()),
    "take returns no sample": altered(lambda values: values[:0]),
    "samples from 0 on differ when they are taken 1 at once": altered(
        lambda values: values + random_numbers.normal(size=values.shape)
    ),
    "samples from 0 on differ when they are taken 1": altered(lambda values: values[::-1]),
    "channels is ('sine',), not a tuple of Channel": {"channels": ("sine",)},
    "two channels have the name 'a'": {"channels": (Channel("a"), Channel("a"))},
    "no channel is a force": {"channels": (Channel("announce", "mV"),)},
    "faults returns None, not a list of texts": {"faults": lambda self: None},
    "limits returns no Limits": {"limits": lambda self: {}},
}


@pytest.mark.parametrize("message", SOURCES)
def test_a_sources_defect_is_named(message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if "it waits" in message:
        monkeypatch.setattr("telepulse.testing.source.WITHIN_S", 0.5)
    with pytest.raises(ConformanceError) as caught:
        check_source(broken_source(**SOURCES[message]), SINE)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_period_that_is_no_whole_number_is_named() -> None:
    class Scene(SineScene):
        def build(self, context: Any) -> Sine:
            source = Sine(self)
            source.period_ns = 1e6  # type: ignore[assignment]
            return source

    with pytest.raises(ConformanceError, match=r"period_ns is 1000000\.0, not a whole number"):
        check_source(Scene, SINE)


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


backwards = itertools.count(1_000_000_000, -1_000_000)
SENSORS: dict[str, tuple[dict[str, Any] | None, dict[str, Any] | None]] = {
    "read did not return within 0.3 s: it waits": ({"read": lambda self: time.sleep(0.5)}, None),
    "close leaves a thread that runs on: reader": ({"close": leave_thread}, None),
    "feed returns a value that is not finite": (
        None,
        fed(lambda block: block._replace(values=block.values * math.inf)),
    ),
    "feed returns values of shape": (
        None,
        fed(lambda block: block._replace(values=np.tile(block.values, 3))),
    ),
    "the device's time goes back, from": (
        None,
        fed(lambda block: block._replace(device_ns=next(backwards), restarted=False)),
    ),
    "missing is negative": (None, fed(lambda block: block._replace(missing=-1))),
    "samples a second came, and the table's rate is 1000 Hz": (
        None,
        fed(lambda block: block._replace(values=np.repeat(block.values, 2, axis=0))),
    ),
    "no sample in 0.5 s": (None, {"feed": lambda self, data: []}),
}


@pytest.mark.parametrize("message", SENSORS)
def test_a_sensors_defect_is_named(message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Short only where it is awaited: a busy machine delays the threads of the other cases too.
    if "it waits" in message:
        monkeypatch.setattr("telepulse.testing.sensor.READ_WITHIN_S", 0.3)
    if "runs on" in message:
        monkeypatch.setattr("telepulse.testing.conformance.ENDS_WITHIN_S", 0.2)
    with pytest.raises(ConformanceError) as caught:
        check_sensor(broken_sensor(*SENSORS[message]), BOARD, seconds=0.5)
    assert message in str(caught.value)


class Aliased(Damped):
    """It keeps the caller's lists, which later have other samples."""

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        self._lists = (times_ns, values)

    def predict(self, instant_ns: int) -> float:
        return self._lists[1][-1] if hasattr(self, "_lists") else 0.0


class Shared(Damped):
    """All instances keep their samples in one place."""

    newest: tuple[int, float] = (-1, 0.0)

    def observe(self, times_ns: list[int], values: list[float]) -> None:
        Shared.newest = max(Shared.newest, (times_ns[-1], values[-1]))
        self._seen = True

    def predict(self, instant_ns: int) -> float:
        return Shared.newest[1] if hasattr(self, "_seen") else 0.0


class Drifting(Damped):
    """Each prediction changes the next."""

    def predict(self, instant_ns: int) -> float:
        self._calls = getattr(self, "_calls", -1) + 1
        return 0.1 * self._calls


def too_long(_: Damped) -> None:
    """Work for two ticks, however fast the processor is."""
    end_s = time.process_time() + 2e-3
    while time.process_time() < end_s:
        pass


PREDICTORS: dict[str, Any] = {
    "it looks ahead: its predictions follow the lists": Aliased,
    "it looks ahead: predictions depend on later samples that another": Shared,
    "predict changes later predictions": Drifting,
    "the prediction 1 ms after the newest sample is nan": {
        "predict": lambda self, t: math.nan if t else 0.0
    },
    "a prediction before any sample is not 0": {"predict": lambda self, t: 1.0},
    "error_n returns -1.0": {"error_n": lambda self, horizon_ns: -1.0},
    "squares_n2 has 3 values: none, or 25": {"squares_n2": (1.0, 2.0, 3.0)},
    "ms of each tick of 1 ms": {"work": too_long},
}


@pytest.mark.parametrize("message", PREDICTORS)
def test_a_predictors_defect_is_named(message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(predictor_module, "LEARNS_S", 0.25)
    change = PREDICTORS[message]
    made = type("Broken", (Damped,), change) if isinstance(change, dict) else change

    class Scene(DampedScene):
        def build(self, tick_ns: int, count: int) -> Any:
            return [made(self.fades_ns) for _ in range(count)]

    with pytest.raises(ConformanceError) as caught:
        check_predictor(Scene, DAMPED)
    assert message in str(caught.value)


def test_predictors_are_counted_and_must_estimate_what_they_say() -> None:
    class One(DampedScene):
        def build(self, tick_ns: int, count: int) -> Any:
            return [Damped(self.fades_ns)]

    with pytest.raises(ConformanceError, match="build returns 1 predictors for 3 channels"):
        check_predictor(One, DAMPED)

    class Estimating(DampedScene):
        estimates_error: ClassVar[bool] = True

    with pytest.raises(ConformanceError, match="estimates_error is true, and after 8 s"):
        check_predictor(Estimating, DAMPED)


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
    "response is not positive": {
        "__init__": lambda self, scene, tick_s: vars(self).update(response=-1.0, force_n=0.0)
    },
    "place(0.5) does not set force_n": {"place": lambda self, force_n: None},
    "the force after 1 steps is nan": {"step": lambda self, output: math.nan},
    "step returns another force than force_n": {
        "step": lambda self, output: VoiceCoil.step(self, output) + 1
    },
}


@pytest.mark.parametrize("message", ACTUATORS)
def test_an_actuators_defect_is_named(message: str) -> None:
    change = ACTUATORS[message]
    made = type("Broken", (VoiceCoil,), change) if isinstance(change, dict) else change

    class Scene(VoiceCoilScene):
        def build(self, tick_s: float) -> Any:
            return made(self, tick_s)

    with pytest.raises(ConformanceError) as caught:
        check_actuator(Scene, COIL)
    assert message in str(caught.value)
