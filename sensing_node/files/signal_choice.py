"""Choice of the signals of a file that are played: its pulse, and the ECG that announces it.

Also the scales to newtons that a file's unit stands for.
"""

import math
import re
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from protocol.config.quantities import parse_quantity
from protocol.errors import SourceError
from pulse_sensors.force_scale import FORCES, MILLIVOLTS
from sensing_node.files.formats import open_signals
from sensing_node.files.recording_plausibility import (
    SECONDS,
    blocks,
    extremes,
    is_time_name,
    never_falls,
)
from sensing_node.files.signals import ColumnKey, SignalFile, SignalInfo

# Units of pressure, in Pa.
PRESSURES = {"mmHg": 133.322, "cmH2O": 98.0665, "kPa": 1e3, "Pa": 1.0}
# Force of a pressure: a contact of 56 mm², so that 40 mmHg, a usual pulse pressure, are 0.3 N.
NEWTONS_PER_MMHG = 7.5e-3
# Height of the median beat of a signal that is neither force nor pressure.
BEAT_N = 0.3
# Least share of the steps of a counter that are one, and its least span.
COUNTING, LEAST_COUNT = 0.9, 3
A_LONG_TIME_S = 3600.0
TIMES, COUNTS = "has times", "counts"
FIRST = "as the first signal; none is a pulse by its name or unit"
# Names of pulses, and of the leads of an ECG, as PhysioNet's databases and others use them.
_PULSE = re.compile(
    r"\b(abp|art|ubp|pleth|ppg|bvp|force|pulse|radial|tono)(?!.*\brate\b)", re.IGNORECASE
)
_ECG = re.compile(
    r"\b(ecg|ekg|fecg|mli{1,3}|mcl\d?|mv\d?|avr|avl|avf|i{1,3}|v\d?)\b", re.IGNORECASE
)
# Fields of a message's stamp, and its number.
_STAMP = re.compile(r"n?secs?|nanosec|usec|stamp|seq|sequence|t_ns", re.IGNORECASE)


class ChosenSignal(NamedTuple):
    """A signal, and the reason for it."""

    signal: SignalInfo
    reason: str


def choose_pulse(file: SignalFile) -> ChosenSignal:
    """Return the signal to play: a pulse by its name or unit, else the first one.

    Clocks, counters and constant signals are not chosen where there is another one. Raises
    SourceError where none can be a pulse.
    """
    order = [
        # Of a message's topic, each of whose fields has it in its name, the field comes first.
        *(
            ChosenSignal(signal, "by its name")
            for part in (_field, str)
            for signal in file.signals
            if _PULSE.search(part(signal.name).replace("_", " "))
        ),
        *(
            ChosenSignal(s, f"by its unit, {s.unit}")
            for s in file.signals
            if s.unit in {**FORCES, **PRESSURES}
        ),
        *(ChosenSignal(signal, FIRST) for signal in file.signals),
    ]
    faults = {signal.number: _no_pulse(file, signal) for signal in file.signals}
    for chosen in order:
        if faults[chosen.signal.number] is None:
            return chosen
    for chosen in order:
        # One that is constant or only rises is refused where it is played, with what to set.
        fault = faults[chosen.signal.number]
        if fault != TIMES and (fault != COUNTS or chosen.reason != FIRST):
            return chosen
    named = (f"{s.name or f'column {s.number}'} {faults[s.number]}" for s in file.signals)
    raise SourceError(f"{file.path}: holds no pulse: {', '.join(named)[:300]}; name one: --channel")


def _no_pulse(file: SignalFile, signal: SignalInfo) -> str | None:
    """Return the reason why a signal is no pulse, whatever its name; or None."""
    field = _field(signal.name)
    if is_time_name(field) or _STAMP.fullmatch(field) or signal.unit in SECONDS:
        return TIMES
    try:
        values = file.load((signal.number,))[0].values
    except SourceError:
        # The source that plays it has the reason.
        return None
    low, high = extremes(values)
    if not low < high:
        return "is constant" if low == high else "holds no number"
    if len(values) > 2 and never_falls(values):
        return "only rises"
    # A counter rises by one up to its highest number; a few of its numbers may be missing.
    counted = np.mod(np.diff(next(blocks(values))), high - low + 1) == 1
    return COUNTS if high - low >= LEAST_COUNT and counted.mean() > COUNTING else None


def _field(name: str) -> str:
    """Return the last part of a field's path, such as "force" of "/pulse.film.force"."""
    return name.rpartition(".")[2] if name.startswith("/") else name


def choose_announcing(file: SignalFile, pulse: SignalInfo) -> SignalInfo | None:
    """Return the first ECG of a file besides the pulse, or None."""
    for signal in file.signals:
        lead = signal.unit in MILLIVOLTS and _ECG.search(signal.name.replace("_", " "))
        if lead and signal.number != pulse.number:
            return signal
    return None


def record_table(
    path: Path, channel: str | None = None, rate: str | None = None
) -> tuple[dict[str, Any], str]:
    """Return the table of a source that plays a record, and a line with what was chosen.

    channel: name or number of the signal to play; None chooses. rate: that of a file which states
    none, such as "500 Hz". Raises SourceError.
    """
    file = open_signals(path)
    if channel is None:
        chosen = choose_pulse(file)
    else:
        names = [signal.name for signal in file.signals]
        key: ColumnKey = int(channel) if channel.isdecimal() and channel not in names else channel
        chosen = ChosenSignal(file.find(key), "as asked for")
    pulse, announcing = chosen.signal, choose_announcing(file, chosen.signal)
    table: dict[str, Any] = {"kind": "recording", "path": str(path.absolute())}
    table["column"] = pulse.number
    text = f"{path}: plays {_title(pulse)}, chosen {chosen.reason}; {_scale_text(pulse.unit)}"
    with suppress(SourceError, ValueError):
        # Without a usable rate, the source is refused.
        column = file.load((pulse.number,))[0]
        info = file.describe(column, None if rate is None else parse_quantity(rate, "frequency"))
        text += f"; it lasts {duration_text(len(column.values) / (info.rate_hz or math.nan))}"
    if announcing is not None:
        table["announce"] = announcing.number
        text += f"; the ECG {_title(announcing)} announces its beats"
    others = [
        each.name or str(each.number)
        for each in file.signals
        if each != pulse and _no_pulse(file, each) is None
    ]
    if others:
        text += f"; the file also has {', '.join(others)[:120]} (--channel)"
    return table, text


def duration_text(seconds: float) -> str:
    """Return a duration in s; from an hour on, in h."""
    return f"{seconds:.4g} s" if seconds < A_LONG_TIME_S else f"{seconds / 3600:.4g} h"


def _title(signal: SignalInfo) -> str:
    name = signal.name or f"column {signal.number}"
    rate = "" if signal.rate_hz is None else f", {signal.rate_hz:g} Hz"
    return f"{name} ({signal.unit or 'no unit'}{rate})"


def _scale_text(unit: str) -> str:
    if unit in FORCES:
        return "as the force at the wrist"
    if unit in PRESSURES:
        return f"its pressure becomes a force, {NEWTONS_PER_MMHG * 1e3:g} mN/mmHg"
    return f"its median beat becomes {BEAT_N:g} N high"
