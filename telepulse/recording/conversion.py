"""Conversion of a file of signals into another format."""

from collections.abc import Iterator
from pathlib import Path

from protocol.errors import SourceError
from pulse_sensors.plausibility import SECONDS, is_time_name, stated_times
from sensing_node.files.formats import open_signals, write_signals
from sensing_node.files.signals import SignalInfo, SignalTable, evenly, find_gaps


def convert_file(source: Path, out: Path) -> Iterator[str]:
    """Convert a file, and yield lines on each signal and on what `out` cannot hold.

    Raises SourceError or OutputError.
    """
    file = open_signals(source)
    for note in file.notes:
        yield f"{source}: {note}"
    wanted = [
        signal
        for signal in file.signals
        if not (is_time_name(signal.name) and (signal.rate_hz is None or signal.unit in SECONDS))
    ]
    signals, values = list[SignalInfo](), []
    columns = file.load([signal.number for signal in wanted])
    for signal, column in zip(wanted, columns, strict=True):
        rate_hz, even = signal.rate_hz, column.values
        if rate_hz is None:
            times = stated_times(column)
            if times is None:
                raise SourceError(
                    f"{source}: states no rate; add a column of times that never fall, or save it"
                    " as an .npz with the array rate_hz"
                )
            rate_hz = times.rate_hz
            if times.gaps:
                rate_hz, even = evenly(times.times_s, even, source, rate_hz)
        name = signal.name or f"column {signal.number}"
        length = len(even)
        signals.append(signal._replace(name=name, rate_hz=rate_hz, samples=length))
        values.append(even)
        gaps = find_gaps(even)
        missing = gaps.text(length, rate_hz) if gaps.samples else "no sample is missing"
        unit = signal.unit or "no unit"
        yield f"{source}: {name}, {unit}, {rate_hz:g} Hz, {length / rate_hz:g} s: {missing}"
    if not signals:
        raise SourceError(f"{source}: holds no signal of numbers")
    table = SignalTable(signals, values, file.begin_ns, file.marks, file.metadata)
    notes = write_signals(out, table)
    yield f"{out}: {'; '.join(notes) or 'written whole'}"
