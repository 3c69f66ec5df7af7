"""Foreign bytes and files: a value or the declared error, at little memory.

The targets and their properties are in fuzz/targets/, which the fuzzer runs as well.
"""

import importlib
import tracemalloc
from collections.abc import Callable
from functools import cache
from typing import Any

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fuzz.targets import NAMES
from tests.support.message_examples import FALSE_LENGTHS, HUGE

# The search for events reads no foreign bytes; tests/unit/pulse_drives has it.
READERS = [name for name in NAMES if name != "supervisor"]
MOST_BYTES = 25_000_000
EXAMPLES = 30

values = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=9)
    | st.binary(max_size=40),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=12,
)


@cache
def target(name: str) -> Any:
    """Load a target and try its seeds, so that no input is charged for one-time set-up."""
    loaded = importlib.import_module(f"fuzz.targets.{name}")
    for seed in loaded.seeds():
        loaded.try_one(seed)
    return loaded


def bounded(try_one: Callable[[bytes], None], data: bytes) -> None:
    """Try an input, and check its peak of memory."""
    tracemalloc.start()
    try:
        try_one(data)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < MOST_BYTES


@st.composite
def mutations(draw: st.DrawFn, seeds: list[bytes]) -> bytes:
    """Draw a seed with a few places cut out, overwritten, repeated or mixed with others."""
    data = draw(st.sampled_from(seeds))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(data)))
        end = draw(st.integers(start, min(len(data), start + 20)))
        other = draw(st.sampled_from(seeds))
        middle = draw(
            st.sampled_from([b"", b"\0", HUGE, data[start:end] * 2])
            | st.binary(max_size=9)
            | st.integers(0, len(other)).map(lambda at, other=other: other[at : at + 20])
        )
        data = data[:start] + middle + data[end:]
    return data


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_mutated_inputs(name: str, data: st.DataObject) -> None:
    loaded = target(name)
    bounded(loaded.try_one, data.draw(mutations(loaded.seeds())))


@pytest.mark.parametrize("name", READERS)
@settings(max_examples=EXAMPLES)
@given(data=st.binary(max_size=300))
def test_any_bytes(name: str, data: bytes) -> None:
    bounded(target(name).try_one, data)


@pytest.mark.parametrize("name", ["control", "frame", "telemetry"])
@settings(max_examples=EXAMPLES)
@given(value=st.lists(values, max_size=5) | values)
def test_any_msgpack(name: str, value: object) -> None:
    bounded(target(name).try_one, msgpack.packb(value))


@pytest.mark.parametrize("name", ["control", "frame", "telemetry"])
@settings(max_examples=EXAMPLES)
@given(data=st.data())
def test_a_message_with_one_field_changed(name: str, data: st.DataObject) -> None:
    loaded = target(name)
    message = msgpack.unpackb(data.draw(st.sampled_from(loaded.seeds())))
    table = message
    while isinstance(table, list | dict) and table:
        keys = list(table) if isinstance(table, dict) else list(range(len(table)))
        key = data.draw(st.sampled_from(keys))
        if not isinstance(table[key], list | dict) or data.draw(st.booleans()):
            small = st.integers(-1, 9)
            table[key] = data.draw(values | small if type(table[key]) is int else values)
            break
        table = table[key]
    bounded(loaded.try_one, msgpack.packb(message))


@pytest.mark.parametrize("data", FALSE_LENGTHS.values(), ids=FALSE_LENGTHS)
def test_a_false_length_costs_nothing(data: bytes) -> None:
    bounded(target("telemetry").try_one, data)
