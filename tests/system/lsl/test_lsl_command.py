import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol.wire.telemetry import CONTROL
from tests.support.log_lines import refused, unusual
from tests.support.lsl_loopback import lsl_on_loopback
from tests.support.nodes import free_address, process
from tests.support.telemetry_publisher import (
    BATCH,
    MS,
    SESSION,
    TelemetryPublisher,
    clock_reply,
    numbered_frame,
    publishing,
)
from tests.support.waiting import until

MODULE = "telepulse"
# Sensing time of the publisher's first sample.
FIRST_NS = 1_000 * MS
RESOLVE_S = 30.0


class Source(TelemetryPublisher):
    """A publisher in real time, with a sensing clock."""

    def send_clock(self, session: int = SESSION) -> None:
        """Send replies until the clock is accepted; its first sample is now."""
        self.ahead_ns = FIRST_NS + self.ticks * MS - time.perf_counter_ns()
        for _ in range(4):
            self.receive(CONTROL, clock_reply(time.perf_counter_ns(), self.ahead_ns, session))
            time.sleep(0.025)

    def publish_for(self, ms: int, session: int = SESSION) -> None:
        for _ in range(ms // 20):
            self.publish(20, session)
            time.sleep(0.02)


@contextmanager
def streaming(address: str, pylsl: Any) -> Iterator[tuple[Source, Any, Any]]:
    """Run a source, an outlet process that reads it, and inlets of wrist and finger."""
    with (
        publishing(address, kind=Source) as source,
        process(MODULE, "record", address, "--lsl") as outlet,
    ):
        source.begin()
        source.send_clock()
        source.publish(40)
        inlets = [inlet(pylsl, address, part) for part in ("wrist", "finger")]
        yield source, outlet, inlets
        del inlets


def inlet(pylsl: Any, address: str, part: str) -> Any:
    found = pylsl.resolve_byprop("source_id", f"telepulse {address} {part}", 1, RESOLVE_S)
    assert found, part
    opened = pylsl.StreamInlet(found[0], recover=False)
    opened.open_stream(RESOLVE_S)
    return opened


def pulled(stream: Any, enough: int) -> tuple[Any, Any]:
    """Return samples and times, once `enough` have come."""
    samples: list[Any] = []
    times_s: list[float] = []

    def come() -> bool:
        more, at_s = stream.pull_chunk(timeout=0.0)
        samples.extend(more)
        times_s.extend(at_s)
        return len(samples) >= enough

    until(come)
    return np.array(samples), np.array(times_s)


def test_an_inlet_receives_the_same_samples_at_the_same_intervals(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pylsl, address = lsl_on_loopback(tmp_path, monkeypatch), free_address()
    with streaming(address, pylsl) as (source, outlet, (wrist, finger)):
        info = wrist.info()
        assert (info.name(), info.type(), info.nominal_srate()) == ("telepulse wrist", "Force", 1e3)
        assert (info.get_channel_labels(), info.get_channel_units()) == (["pulse"], ["N"])
        assert info.desc().child("acquisition").child_value("manufacturer") == "telepulse"
        assert finger.info().get_channel_labels() == ["target", "felt"]
        first = source.frames
        source.publish_for(400)
        # One frame is lost on the way to the display.
        source.frames += 1
        source.ticks += BATCH
        source.publish_for(800)
        frames = [n for n in range(first, source.frames) if n != first + 400 // BATCH]
        values, times_s = pulled(wrist, BATCH * len(frames))
        expected = np.concatenate([numbered_frame(n).values for n in frames])
        np.testing.assert_array_equal(values.astype("<f4"), expected)
        apart_s = np.diff(times_s)
        gap = 400 - 1
        np.testing.assert_allclose(np.delete(apart_s, gap), 1e-3, atol=2e-5)
        assert apart_s[gap] == pytest.approx((1 + BATCH) * 1e-3, abs=2e-5)
        # The sample's instant on the host's clock, which LSL uses.
        sensing_s = (FIRST_NS + first * BATCH * MS - source.ahead_ns) * 1e-9
        lsl_ahead_s = pylsl.local_clock() - time.perf_counter_ns() * 1e-9
        assert times_s[0] == pytest.approx(sensing_s + lsl_ahead_s, abs=0.05)
        forces_n, ticks_s = pulled(finger, 600)
        assert forces_n[0, 0] == 0.5
        np.testing.assert_allclose(np.diff(forces_n[:400, 1]), 1e-3)
        assert np.all(np.diff(ticks_s) > 0)
        source.status("ended", final=True)
        _, errors = outlet.communicate(timeout=30)
        assert (outlet.returncode, unusual(errors)) == (0, "")
    assert f"{BATCH} samples missing" in errors
    assert f"{source.frames * BATCH - BATCH} samples" in errors


def test_a_file_or_lsl_is_chosen(address: str) -> None:
    for options in ((), ("run.mcap", "--lsl"), ("--lsl", "--marks")):
        assert "give FILE.mcap, or --lsl" in refused(MODULE, "record", address, *options)
