"""Choice of the signals of a file that are played: its pulse, and the ECG that announces it.

The pulse is chosen by its shape; names and units order what has that shape. Where two are left, the
choice is refused, with what was found of each.
"""

import math
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from protocol.config.quantities import parse_quantity
from protocol.errors import SourceError
from pulse_sensors.force_scale import FORCES, MILLIVOLTS
from sensing_node.files.column_kind import (
    ANY_HZ,
    FEWEST,
    PPG,
    PRESSURE,
    PRESSURES,
    SIGNAL,
    Pulse,
    find_pulse,
    is_ecg,
    kind_of,
    rank,
    steady,
    words,
)
from sensing_node.files.formats import open_signals
from sensing_node.files.recording_plausibility import extremes
from sensing_node.files.signals import ColumnKey, Floats, SignalFile, SignalInfo

# Force of a pressure: a contact of 56 mm², so that 40 mmHg, a usual pulse pressure, are 0.3 N.
NEWTONS_PER_MMHG = 7.5e-3
# Height of the median beat of a signal that is neither force nor pressure.
BEAT_N = 0.3
A_LONG_TIME_S = 3600.0
# Least correlation of channels of one pulse, and of those of one shape; the length in s in which it
# is taken, and the most that another one is higher.
ONE_PULSE, ONE_SHAPE, ONE_PULSE_S, MOST_HEIGHTS = 0.7, 0.999, 60.0, 2.0
# Length of a signal in s from which its shape is known.
SHORTEST_S = 3.0
# Colours of one sensor of light.
COLOURS = {"ir", "red", "green", "infrared"}


class ChosenSignal(NamedTuple):
    """A signal, and the reason for it."""

    signal: SignalInfo
    reason: str


class _Candidate(NamedTuple):
    """Findings of a signal: its fault or None, its pulse, and samples without drift.

    short: its shape is not known. known_rate: the rate of its pulse is.
    """

    signal: SignalInfo
    fault: str | None
    pulse: Pulse | None = None
    known_rate: bool = False
    short: bool = False
    level: Floats = np.empty(0)

    @property
    def rank(self) -> float:
        """See `column_kind.rank`."""
        return rank(self.signal.name, self.signal.unit)

    def text(self) -> str:
        """Return the name and the findings, for people."""
        found = "too short" if self.short else "no pulse"
        if self.pulse is not None:
            found = f"{self.pulse.per_min:.0f} /min" if self.known_rate else "periodic"
        return f"{self.signal.name or f'column {self.signal.number}'} {self.fault or found}"


def choose_pulse(file: SignalFile, rate_hz: float | None = None) -> ChosenSignal:
    """Return the signal to play: the one with the shape of a pulse, of the first rank.

    rate_hz: as an option states it. Raises SourceError where none has it, or where several of one
    rank have and are not channels of one pulse.
    """
    found = [_examined(file, signal, rate_hz) for signal in file.signals]
    # One column leaves nothing to choose; what cannot be played is refused where it would be.
    alone = len(found) == 1 and len(file.titles) <= 1
    if len(found) == 1 and found[0].pulse is None and (alone or found[0].fault is not None):
        return ChosenSignal(found[0].signal, "as the only signal, though it has no steady pulse")
    pool = [each for each in found if each.pulse] or [each for each in found if each.short]
    least = min((each.rank for each in pool), default=0)
    best = [each for each in pool if each.rank == least]
    if least == PRESSURE:
        # PPGs with the very same shape are channels of its pulse.
        same = [each for each in pool if each.rank == PPG and _alike(best[0], each) > ONE_SHAPE]
        best = [each for each in pool if each in best or each in same]
    if not best or not all(_of_one_pulse(best[0], other) for other in best[1:]):
        listed = ", ".join(each.text() for each in [*best, *(f for f in found if f not in best)])
        fault = "has several signals that may be the pulse" if best else "holds no pulse"
        raise SourceError(f"{file.path}: {fault}: {listed[:300]}; name one: --channel")
    signal, pulse = best[0].signal, best[0].pulse
    if pulse is None:
        return ChosenSignal(signal, "by its name, unit or place, as it is too short for its shape")
    return ChosenSignal(
        signal, f"by its pulse, {pulse.per_min:.0f} /min" if best[0].known_rate else "by its shape"
    )


def _opened(
    file: SignalFile, signal: SignalInfo, rate_hz: float | None
) -> tuple[Floats, list[float], str | None] | None:
    """Return values, rates and the fault of a signal, or None where it cannot be played."""
    try:
        column = file.load((signal.number,))[0]
        rates_hz = file.rates_hz(signal, column, rate_hz)
    except SourceError:
        # The source that plays it has the reason.
        return None
    fault = None
    low, high = extremes(column.values)
    if not low < high:
        fault = "is constant" if low == high else "holds no number"
    elif (kind := kind_of(signal.name, signal.unit, column.values)) != SIGNAL:
        fault = f"is a {kind}"
    return column.values, rates_hz, fault


def _examined(file: SignalFile, signal: SignalInfo, rate_hz: float | None) -> _Candidate:
    opened = _opened(file, signal, rate_hz)
    if opened is None:
        return _Candidate(signal, None, short=True)
    values, rates_hz, fault = opened
    if fault is not None:
        return _Candidate(signal, fault)
    pulses = [(find_pulse(values, rate), rate) for rate in rates_hz or ANY_HZ]
    seen = [(pulse, rate) for pulse, rate in pulses if pulse is not None]
    pulse, rate = seen[0] if seen else (None, (rates_hz or ANY_HZ)[0])
    short = not seen and len(values) < max(FEWEST, SHORTEST_S * min(rates_hz or (0,)))
    first = values[: round(ONE_PULSE_S * rate)]
    level = np.empty(0) if pulse is None else steady(first, rate)[0]
    return _Candidate(signal, None, pulse, bool(rates_hz) and len(seen) == 1, short, level)


def _of_one_pulse(one: _Candidate, other: _Candidate) -> bool:
    """Return whether signals are channels of one pulse, of which the first is played."""
    if all(COLOURS & set(words(each.signal.name)) for each in (one, other)):
        return True
    if one.pulse is None or _alike(one, other) < ONE_PULSE:
        return False
    higher = np.std(other.level) / np.std(one.level) > MOST_HEIGHTS
    return one.rank != other.rank or not (higher and one.signal.unit == other.signal.unit)


def _alike(one: _Candidate, other: _Candidate) -> float:
    """Return the correlation of two signals of one rate and length; 0 for others."""
    same = len(one.level) == len(other.level) > 0
    return float(np.corrcoef(one.level, other.level)[0, 1]) if same else 0.0


def choose_announcing(file: SignalFile, pulse: SignalInfo) -> SignalInfo | None:
    """Return the first ECG of a file besides the pulse, or None."""
    for signal in file.signals:
        lead = signal.unit in MILLIVOLTS and is_ecg(signal.name)
        if lead and signal.number != pulse.number:
            return signal
    return None


def record_table(
    path: Path, channel: str | None = None, rate: str | None = None
) -> tuple[dict[str, Any], str]:
    """Return the table of a source that plays a record, and a line with what was chosen.

    channel: name or number of the signal to play; None chooses. rate: that to play it at, such as
    "500 Hz"; None takes that of the file. Raises SourceError.
    """
    file = open_signals(path)
    rate_hz = None
    with suppress(ValueError):
        # A rate that is none is refused where the source is.
        rate_hz = None if rate is None else parse_quantity(rate, "frequency")
    if channel is None:
        chosen = choose_pulse(file, rate_hz)
    else:
        names = [signal.name for signal in file.signals]
        key: ColumnKey = int(channel) if channel.isdecimal() and channel not in names else channel
        chosen = ChosenSignal(file.find(key), "as asked for")
    pulse, announcing = chosen.signal, choose_announcing(file, chosen.signal)
    table: dict[str, Any] = {"kind": "recording", "path": str(path.absolute())}
    table["column"] = pulse.number
    lasts, others = "", []
    with suppress(SourceError):
        # Without a usable rate, the source is refused.
        column = file.load((pulse.number,))[0]
        pulse = file.describe(column, rate_hz)
        lasts = f"; it lasts {duration_text(len(column.values) / (pulse.rate_hz or math.nan))}"
    text = f"{path}: plays {_title(pulse)}, chosen {chosen.reason}; {_scale_text(pulse.unit)}"
    text += lasts
    if announcing is not None:
        table["announce"] = announcing.number
        text += f"; the ECG {_title(announcing)} announces its beats"
    for each in file.signals:
        if each.number == pulse.number:
            continue
        opened = _opened(file, each, rate_hz)
        if opened is None or opened[2] is None:
            others.append(each.name or str(each.number))
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
