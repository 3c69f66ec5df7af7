"""Export of a recording's forces as signals, for the viewers and tools of physiology.

The recording's longest session is resampled at a constant rate on the sensing clock. Losses and
events become annotations.
"""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.tracking_error import MAX_GAP_NS, interpolate
from protocol.config.quantities import count_text
from protocol.errors import SourceError
from sensing_node.files.formats import write_signals
from sensing_node.files.signals import FileMark, SignalInfo, SignalTable
from telepulse.recording.session import RecordedSession, felt_force, longest_session

SECOND_NS = 1_000_000_000
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def export_signals(path: Path, file: Path, suffix: str = ".edf") -> str:
    """Write a recording's forces in the format of a suffix, and return a line for the log.

    Raises SourceError or OutputError.
    """
    table, text = recording_signals(path)
    notes = write_signals(file, table, suffix)
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
    t_ns, numbers, values = _samples(session)
    felt = felt_force(path, session.number)
    rate_hz, begin_ns = round(description.rate_hz), int(t_ns[0])
    seconds = math.ceil((t_ns[-1] - begin_ns + period_ns) / SECOND_NS)
    grid_ns = begin_ns + np.arange(seconds * rate_hz, dtype=np.int64) * SECOND_NS // rate_hz
    forces = [
        (
            f"{'Force' if channel.unit == 'N' else 'ECG'} {channel.name}",
            _resampled(grid_ns, t_ns, values[:, index]),
            "mN" if channel.unit == "N" else "uV",
        )
        for index, channel in enumerate(description.channels)
    ]
    for name, force_n in zip(felt.contactors, felt.forces_n.T, strict=True):
        label = f"Felt {name}" if name else "Force felt"
        forces.append((label, _resampled(grid_ns, felt.t_ns, force_n), "mN"))
    if not np.isnan(felt.press_n).all():
        forces.append(("Press", _resampled(grid_ns, felt.t_ns, felt.press_n), "mN"))
    losses = _losses(t_ns, numbers, period_ns)
    events = [FileMark(max(0, at_ns - begin_ns) * 1e-9, text) for at_ns, text in felt.events]
    missing_end = [FileMark(seconds, session.cut)] if session.cut else []
    origin = [
        FileMark(0.0, f"{key} {run[key]}")
        for run in session.provenance
        for key in ("version", "commit", "host", "command")
        if key in run
    ]
    table = SignalTable(
        [
            SignalInfo(number, name, unit, float(rate_hz), len(grid_ns))
            for number, (name, _, unit) in enumerate(forces)
        ],
        # From N, and from mV of an ECG.
        [1e3 * each for _, each, _ in forces],
        begin_ns - felt.sensing_minus_unix_ns,
        [*losses, *events, *missing_end, *origin],
        session.about,
    )
    return table, (
        f"{seconds} s at {rate_hz} Hz, {count_text(len(losses), 'loss', 'losses')}"
        f" and {count_text(len(events), 'event')} as annotations"
    )


def _samples(session: RecordedSession) -> tuple[Ints, Ints, Floats]:
    """Return times, sequence numbers and values of all samples, in order of time."""
    times, numbers, values = [], [], []
    for frame in session.frames():
        at = np.arange(len(frame.values), dtype=np.int64)
        times.append(frame.t_first_ns + at * frame.period_ns)
        numbers.append(frame.first_sample + at)
        values.append(frame.values.astype(np.float64))
    return np.concatenate(times), np.concatenate(numbers), np.concatenate(values)


def _losses(t_ns: Ints, numbers: Ints, period_ns: int) -> list[FileMark]:
    """Return a mark for each gap in the sequence numbers."""
    return [
        FileMark(
            (int(t_ns[at] - t_ns[0]) + period_ns) * 1e-9,
            f"{count_text(missing, 'sample')} lost",
            missing * period_ns * 1e-9,
        )
        for at, missing in enumerate((np.diff(numbers) - 1).tolist())
        if missing > 0
    ]


def _resampled(grid_ns: Ints, t_ns: Ints, force_n: Floats) -> Floats:
    """Interpolate linearly; NaN outside, and between values that are too far apart."""
    on_grid_n = interpolate(grid_ns, t_ns, force_n)
    # At a sample before a gap `interpolate` returns NaN; the sample's own value is used.
    at = np.minimum(np.searchsorted(t_ns, grid_ns), len(t_ns) - 1)
    return np.where(t_ns[at] == grid_ns, force_n[at], on_grid_n)
