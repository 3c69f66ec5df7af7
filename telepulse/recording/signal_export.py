"""Export of a recording's forces as signals, for the viewers and tools of physiology.

The recording's longest session is resampled at a constant rate on the sensing clock. Losses and
events become annotations.
"""

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.tracking_error import MAX_GAP_NS, interpolate
from protocol.config.quantities import count_text
from protocol.errors import OutputError, SourceError
from protocol.wire.marks import printable
from telepulse.columns import UNKNOWN_NS, SessionColumns, join_ticks
from telepulse.recording import edf_writer, wfdb_writer, xdf_writer
from telepulse.recording.contents import read_contents
from telepulse.recording.mcap_reader import RecordingReader
from telepulse.recording.session import RecordedSession, longest_session
from telepulse.recording.signal_table import Annotation, Floats, SignalTable, SignalWriter

SECOND_NS = 1_000_000_000
MOST_CHARACTERS = 1000
WRITERS: dict[str, SignalWriter] = {
    ".edf": edf_writer.write,
    ".hea": wfdb_writer.write,
    ".xdf": xdf_writer.write,
}
Ints = NDArray[np.int64]


def export_signals(path: Path, file: Path, suffix: str = ".edf") -> str:
    """Write a recording's forces in the format of a suffix, and return a line for the log.

    Raises SourceError or OutputError.
    """
    table, text = recording_signals(path)
    if file.exists():
        raise OutputError(f"{file}: exists already; name another file")
    try:
        notes = WRITERS[suffix](file, table)
    except ImportError as error:
        raise OutputError(
            f"{file}: an export to {suffix[1:]} needs {error.name}, which cannot be loaded"
            f" ({error}); pip install {error.name}"
        ) from None
    except OSError as error:
        raise OutputError(f"{file}: cannot be written: {error.strerror or error}") from None
    except ValueError as error:
        raise OutputError(f"{file}: cannot hold these signals: {error}") from None
    return f"{file}: {'; '.join([text, *notes])}"


def recording_signals(path: Path) -> tuple[SignalTable, str]:
    """Return forces in mN and ECG in uV of a recording, and a text on them. Raises SourceError."""
    session = longest_session(path)
    description = session.description
    period_ns = description.period_ns
    if period_ns > MAX_GAP_NS:
        slowest_hz = math.ceil(SECOND_NS / MAX_GAP_NS)
        raise SourceError(
            f"{path}: its rate is {description.rate_hz:g} Hz, below the {slowest_hz} Hz"
            " that an export of signals needs; export it to csv"
        )
    contents = read_contents(RecordingReader(path))
    described = [each for each in contents.sessions if each.description is not None]
    parts = [each for each in described if each.number == session.number] or [SessionColumns()]
    sensing_ns, unix_ns = (join_ticks(parts, column) for column in ("sensing_ns", "unix_ns"))
    known = sensing_ns != UNKNOWN_NS
    if not known.any():
        raise SourceError(f"{path}: holds no tick while the sensing clock was known")
    ahead_ns = (sensing_ns - unix_ns)[known]
    t_ns, numbers, values = _samples(session)
    rate_hz, begin_ns = round(description.rate_hz), int(t_ns[0])
    seconds = math.ceil((t_ns[-1] - begin_ns + period_ns) / SECOND_NS)
    grid_ns = begin_ns + np.arange(seconds * rate_hz, dtype=np.int64) * SECOND_NS // rate_hz
    signals = [
        (
            f"{'Force' if channel.unit == 'N' else 'ECG'} {channel.name}",
            "mN" if channel.unit == "N" else "uV",
            interpolate(grid_ns, t_ns, values[:, index]),
        )
        for index, channel in enumerate(description.channels)
    ]
    order = np.flatnonzero(known)[np.argsort(sensing_ns[known], kind="stable")]
    for name, felt_n in _felt_forces(parts):
        signals.append((name, "mN", interpolate(grid_ns, sensing_ns[order], felt_n[order])))
    losses = _losses(t_ns, numbers, period_ns)
    events = [event for event in contents.events if event.session == session.number]
    # The clock at an event is that of the last tick before it.
    ticks = np.searchsorted(unix_ns[known], [event.unix_ns for event in events], "right") - 1
    times_ns = [event.unix_ns for event in events] + ahead_ns[np.maximum(ticks, 0)] - begin_ns
    missing_end = [Annotation(seconds, session.cut)] if session.cut else []
    origin = [
        Annotation(0.0, f"{key} {run[key]}")
        for run in session.provenance
        for key in ("version", "commit", "host", "command")
        if key in run
    ]
    annotations = [
        *losses,
        *(
            Annotation(max(0, at_ns) * 1e-9, f"{event.name}: {event.text}")
            for at_ns, event in zip(times_ns.tolist(), events, strict=True)
        ),
        *missing_end,
        *origin,
    ]
    names, units, columns = zip(*signals, strict=True)
    # From N, and from mV of an ECG.
    scaled = 1e3 * np.stack(columns, axis=1)
    table = SignalTable(
        _distinct(names),
        units,
        np.where(np.isfinite(scaled), scaled, np.nan),
        rate_hz,
        begin_ns - int(ahead_ns[0]),
        [each._replace(text=printable(each.text, MOST_CHARACTERS)) for each in annotations],
        {key: printable(text, MOST_CHARACTERS) for key, text in session.about.items()},
    )
    return table, (
        f"{seconds} s at {rate_hz} Hz, {count_text(len(losses), 'loss', 'losses')}"
        f" and {count_text(len(events), 'event')} as annotations"
    )


def _felt_forces(parts: Sequence[SessionColumns]) -> Iterator[tuple[str, Floats]]:
    """Yield name and force in N of each contactor, and the press of a finger that presses back."""
    names = list(parts[-1].playing) or [""]
    for name in names:
        felt_n = np.concatenate([part.forces_n(name)[1] for part in parts])
        yield f"Felt {name}" if len(names) > 1 else "Force felt", felt_n
    press_n = join_ticks(parts, "press_n")
    if not np.isnan(press_n).all():
        yield "Press", press_n


def _distinct(names: Sequence[str]) -> list[str]:
    """Return names with a number after each that another one has already: "Felt 2"."""
    taken: list[str] = []
    for name in names:
        number, free = 2, name
        while free in taken:
            number, free = number + 1, f"{name} {number}"
        taken.append(free)
    return taken


def _samples(session: RecordedSession) -> tuple[Ints, Ints, Floats]:
    """Return times, sequence numbers and values of all samples, in order of time."""
    times, numbers, values = [], [], []
    for frame in session.frames():
        at = np.arange(len(frame.values), dtype=np.int64)
        times.append(frame.t_first_ns + at * frame.period_ns)
        numbers.append(frame.first_sample + at)
        values.append(frame.values.astype(np.float64))
    return np.concatenate(times), np.concatenate(numbers), np.concatenate(values)


def _losses(t_ns: Ints, numbers: Ints, period_ns: int) -> list[Annotation]:
    """Return a mark for each gap in the sequence numbers."""
    return [
        Annotation(
            (int(t_ns[at] - t_ns[0]) + period_ns) * 1e-9,
            f"{count_text(missing, 'sample')} lost",
            missing * period_ns * 1e-9,
        )
        for at, missing in enumerate((np.diff(numbers) - 1).tolist())
        if missing > 0
    ]
