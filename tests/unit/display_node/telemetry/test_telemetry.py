import math
from collections.abc import Callable
from pathlib import Path

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from display_node.display import Display
from display_node.plant.feedback import Feedback
from display_node.scene import DisplayScene
from protocol.config.scene import load_section
from protocol.errors import WireError
from protocol.faults import FaultKind, faults_of
from protocol.summary.fields import SampleCounts, Summary
from protocol.ticks import TickState
from protocol.wire.messages import LARGEST_N, TIME_RANGE
from protocol.wire.telemetry import Trace, TraceWriter, read_status, read_trace
from tests.support.sender import MS, Sender, run
from tests.support.tick_blocks import TRACE_TICKS, packed_trace, tick_block

RADIAL = Path(__file__).parents[4] / "scenes" / "radial.toml"
times_ns = st.integers(TIME_RANGE.start, TIME_RANGE.stop - 1)
forces_n = st.floats(-LARGEST_N, LARGEST_N)
ticks = st.builds(
    TickState,
    now_ns=times_ns,
    instant_ns=times_ns,
    target_n=forces_n,
    felt_n=forces_n | st.just(math.nan),
    full=st.booleans(),
    predictor_error_n=forces_n | st.just(math.nan),
    trusted=st.booleans(),
    press_n=forces_n | st.just(math.nan),
    hold_down_n=forces_n | st.just(math.nan),
)


@settings(max_examples=20)
@given(st.lists(ticks, min_size=2, max_size=2 * TRACE_TICKS), st.data())
def test_a_trace_has_every_tick_of_each_contactor_since_the_last_one(
    felt: list[TickState], data: st.DataObject
) -> None:
    felt.sort(key=lambda tick: tick.now_ns)
    other, writer = data.draw(ticks), TraceWriter()
    cut = data.draw(st.integers(1, len(felt) - 1))
    for block in (felt[:cut], felt[cut:]):
        writer.add(tick_block(*block, others=[other]))
    trace, others = read_trace(writer.rest() or b"")
    for name in Trace._fields:
        np.testing.assert_array_equal(getattr(trace, name), [getattr(tick, name) for tick in felt])
    np.testing.assert_array_equal(others.felt_n, [other.felt_n] * len(felt))
    assert writer.rest() is None


def trace_of(**changes: object) -> Trace:
    """Read a trace of equal ticks, with changes to the last one."""
    felt = [TickState(tick, tick, tick, 0.5, 0.4, True, 0.01) for tick in range(TRACE_TICKS)]
    for name, value in changes.items():
        setattr(felt[-1], name, value)
    return read_trace(packed_trace(*felt))[0]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300, -1e300])
@pytest.mark.parametrize("name", ["felt_n", "predictor_error_n"])
def test_an_impossible_figure_is_read_as_unknown(name: str, value: float) -> None:
    column = getattr(trace_of(**{name: value}), name)
    assert np.isfinite(column[:-1]).all()
    assert math.isnan(column[-1])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        *(({"target_n": value}, "target") for value in (math.nan, math.inf, -math.inf, 1e300)),
        ({"now_ns": 3}, "time"), ({"now_ns": 2**62}, "time"), ({"instant_ns": -(2**63)}, "time"),
    ], ids=str,
)  # fmt: skip
def test_impossible_targets_and_times_that_fall_or_are_out_of_range_are_refused(
    changes: dict[str, float], reason: str
) -> None:
    with pytest.raises(WireError, match=reason):
        trace_of(**changes)


def status_of(summary: object) -> list[object]:
    return ["playing", "stream", summary, True, None, None, []]


NO_TRACES = (
    *([b"\0" * now, b"\0" * rest] for now, rest in ((48, 16), (24, 32), (23, 16))),
    *([b"\0" * 24], ["a", "b"], [None, None], 17),
)
STATUS = status_of({})
NO_STATUSES = (
    *("abcd", {"a": 1, "b": 2, "c": 3, "d": 4}, None, STATUS[:3]),
    *([*STATUS[:at], no, *STATUS[at + 1 :]] for at, no in enumerate((1, None, [], 1))),
)
NO_SUMMARIES = (
    *({"samples": None}, {"samples": {"late": "many"}}, {"loop": []}, {"rejected": {"crc": "x"}}),
    *({"faults": "none"}, {"clock": {"offset_ms": {}}}, {"notes": [{}]}),
    *({"notes": [], "faults": ["lost"]}, {"faults": ["lost", {}]}),
)


@pytest.mark.parametrize(
    ("read", "value", "reason"),
    [
        *((read_trace, value, None) for value in NO_TRACES),
        *((read_status, value, None) for value in NO_STATUSES),
        *((read_status, status_of(value), "a status' summary") for value in NO_SUMMARIES),
        *(
            (read_status, status_of(Summary(samples=SampleCounts(sent=sent)).to_dict()), "range")
            for sent in (2**53, 2**63)
        ),
    ],
)
def test_an_invalid_message_is_refused(
    read: Callable[[bytes], object], value: object, reason: str | None
) -> None:
    with pytest.raises(WireError, match=reason):
        read(msgpack.packb(value))


@pytest.mark.parametrize("figure", [math.nan, math.inf, -math.inf, 1e300])
def test_a_status_has_every_key_of_a_summary_and_no_impossible_figure(figure: float) -> None:
    summary = {"samples": {"late": 3}, "within_jnd": figure, "of a later version": 1}
    status = read_status(msgpack.packb(status_of(summary)))
    assert status.summary == Summary(samples=SampleCounts(late=3)).to_dict()


def test_a_silent_film_is_a_fault_and_its_force_unknown() -> None:
    display = Display(load_section(RADIAL, "display", DisplayScene), "test")
    feedback = display.contactors[0].feedback = Feedback(0, 40 * MS)
    sender, writer = Sender(), TraceWriter()
    display.take_ticks = writer.add
    for ms in range(3_000):
        if ms < 2_000:
            feedback.add(ms * MS, 0.3)
        run(display, sender, ms, ms + 1)
    display.close_block()
    messages = [writer.rest()]
    felt_n = np.concatenate([read_trace(message)[0].felt_n for message in messages if message])
    assert np.isfinite(felt_n[:2_000]).all()
    assert np.isnan(felt_n[2_100:]).all()
    display.finish_scores()
    status = read_status(display.pack_status(display.summary(), final=False))
    (fault,) = faults_of(status.summary)
    assert (status.state, fault.kind) == ("fault", FaultKind.SILENT)
    assert fault.at_ns == 2_040 * MS
    assert status.summary["force_rmse_n"]["aligned"] is not None
    assert status.summary["availability"]["faulted"] == pytest.approx(1 / 3, abs=0.02)
