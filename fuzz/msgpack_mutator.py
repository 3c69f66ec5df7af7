"""Mutations of msgpack that stay msgpack: random bytes seldom remain a message."""

import math
import random
from typing import Any

import atheris
import msgpack

ODD: tuple[Any, ...] = (
    *(None, True, 0, 1, -1, 255, 2**31, 2**32, 2**53, 2**62, 2**63 - 1, 2**64 - 1, -(2**63)),
    *(0.0, 1.5, 5e-324, 1e308, math.nan, math.inf, -math.inf),
    *("", "x" * 81, "\n", "\ud7ff", b"", bytes(8), bytes(999)),
    *([], [[]], {}, {"": 0}, msgpack.Timestamp(0), msgpack.ExtType(5, b"")),
)


def mutate(data: bytes, max_size: int, seed: int) -> bytes:
    """Apply libFuzzer's own mutation half of the time, else change one place of the message."""
    rng = random.Random(seed)
    if rng.random() < 0.5:
        return bytes(atheris.Mutate(data, max_size))
    try:
        changed = msgpack.packb(_changed(msgpack.unpackb(data, strict_map_key=False), rng))
    except Exception:  # not msgpack, or the result cannot be packed
        return bytes(atheris.Mutate(data, max_size))
    return changed if len(changed) <= max_size else data


def _changed(value: Any, rng: random.Random) -> Any:
    if isinstance(value, list) and value and rng.random() < 0.9:
        return _changed_list(list(value), rng)
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = rng.choice(list(value))
        if rng.random() < 0.1:
            return {k: v for k, v in value.items() if k != key}
        return {**value, key: _changed(value[key], rng)}
    if isinstance(value, bytes) and rng.random() < 0.8:
        return bytes(atheris.Mutate(value, len(value) + 16))
    if type(value) is int and rng.random() < 0.5:
        return value + rng.choice((-1, 1, 1_000_000, -1_000_000_000))
    return rng.choice(ODD)


def _changed_list(value: list[Any], rng: random.Random) -> list[Any]:
    place = rng.randrange(len(value))
    match rng.randrange(10):
        case 0:
            del value[place]
        case 1:
            value.insert(place, rng.choice(ODD))
        case _:
            value[place] = _changed(value[place], rng)
    return value
