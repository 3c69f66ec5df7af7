"""Conversion of a file of signals into another format."""

from collections.abc import Iterator
from pathlib import Path

from pulse_sensors.plausibility import SECONDS, is_time_name
from sensing_node.files.formats import open_signals, write_signals
from sensing_node.files.grids import evenly, find_gaps
from sensing_node.files.signals import SignalFile, SignalInfo, SignalTable, split_unit
from sensing_node.sources.choice import choose_pulse

# Times in s that are Unix times, of 2001 to 2096: no other clock has run for so long.
UNIX_S = (1e9, 4e9)


def convert_file(source: Path, out: Path) -> Iterator[str]:
    """Convert a file, and yield lines on each signal and on what `out` cannot hold.

    Raises SourceError or OutputError.
    """
    file = open_signals(source)
    for note in file.notes:
        yield f"{source}: {note}"
    wanted, begin_ns = _wanted(file), file.begin_ns
    signals, values = list[SignalInfo](), []
    columns = file.load([signal.number for signal in wanted])
    for note in dict.fromkeys(note for column in columns for note in column.notes):
        yield f"{source}: {note}"
    for signal, column in zip(wanted, columns, strict=True):
        described, times = file.describe(column)
        rate_hz, even = described.rate_hz or 0.0, column.values
        if times is not None:
            if times.gaps:
                rate_hz, even = evenly(times.times_s, even, source, rate_hz)
            if begin_ns is None and UNIX_S[0] < times.times_s[0] < UNIX_S[1]:
                begin_ns = round(float(times.times_s[0]) * 1e6) * 1000
        name = signal.name or f"column {signal.number}"
        length = len(even)
        signals.append(signal._replace(name=name, rate_hz=rate_hz, samples=length))
        values.append(even)
        gaps = find_gaps(even)
        missing = gaps.text(length, rate_hz) if gaps.samples else "no sample is missing"
        unit = signal.unit or "no unit"
        yield f"{source}: {name}, {unit}, {rate_hz:g} Hz, {length / rate_hz:g} s: {missing}"
    table = SignalTable(signals, values, begin_ns, file.marks, file.metadata)
    notes = write_signals(out, table)
    yield f"{out}: {'; '.join(notes) or 'written whole'}"


def _wanted(file: SignalFile) -> list[SignalInfo]:
    """Return the signals that are no times: neither by their names, nor as a source finds them."""
    (pulse,) = file.load((choose_pulse(file).signal.number,))
    _, times = file.describe(pulse)
    own = set[str]() if times is None else {split_unit(times.name)[0], times.name}
    return [
        signal
        for signal in file.signals
        if not (is_time_name(signal.name) and (signal.rate_hz is None or signal.unit in SECONDS))
        and (signal.name or str(signal.number)) not in own
    ]
