"""Files of signals, written byte by byte or by other libraries."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def pulse_and_ecg(seconds: float = 4.0, rate_hz: int = 250) -> dict[str, Floats]:
    """Return an ECG in mV, a pressure in mmHg of 40 mmHg a beat, and a respiration in V."""
    t_s = np.arange(round(seconds * rate_hz)) / rate_hz
    beat = t_s % 0.8
    ecg = np.exp(-(((beat - 0.1) / 0.01) ** 2))
    pressure = 80 + 40 * np.exp(-(((beat - 0.35) / 0.08) ** 2))
    return {"II": ecg, "ABP": pressure, "RESP": 0.1 * np.sin(1.5 * t_s)}


UNITS = {"II": "mV", "ABP": "mmHg", "RESP": "V"}
GAINS = {"II": 2000.0, "ABP": 100.0, "RESP": 3000.0}


def wfdb_record(
    folder: Path, signals: Mapping[str, Floats], rate: str = "250", name: str = "rec"
) -> Path:
    """Write a record in format 16 by hand, NaN as missing; return its name without a suffix."""
    table = np.stack([values * GAINS[key] for key, values in signals.items()], axis=1)
    codes = np.where(np.isnan(table), -32768, np.rint(np.nan_to_num(table))).astype("<i2")
    (folder / f"{name}.dat").write_bytes(codes.tobytes())
    lines = [f"{name} {len(signals)} {rate} {len(codes)} 12:00:00 24/11/2016"]
    lines += [f"{name}.dat 16 {GAINS[key]:g}/{UNITS[key]} 16 0 0 0 0 {key}" for key in signals]
    (folder / f"{name}.hea").write_text("\n".join([*lines, "# a note", ""]), encoding="utf-8")
    return folder / name


def mcap(
    path: Path, contents: Sequence[Any], topic: str = "/pulse", encoding: str = "json"
) -> Path:
    """Write messages at 250 Hz, and return the path."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sensor", "jsonschema", b"{}")
        channel = writer.register_channel(topic, encoding, schema)
        for number, content in enumerate(contents):
            at_ns = 10**18 + number * 4_000_000
            writer.add_message(channel, at_ns, json.dumps(content).encode(), at_ns)
        writer.finish()
    return path


def beats_per_min(values: Floats, rate_hz: float) -> float:
    """Return the rate of a clean pulse, by its rises from its lowest to its highest quarter."""
    share = (values - values.min()) / np.ptp(values)
    outer = np.flatnonzero((share < 0.25) | (share > 0.75))
    high = share[outer] > 0.75
    rises = outer[1:][high[1:] & ~high[:-1]]
    return float(60 * rate_hz * (len(rises) - 1) / (rises[-1] - rises[0]))
