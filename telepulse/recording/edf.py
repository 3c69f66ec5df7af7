"""Export of a recording as an EDF+ file, for the viewers and tools of physiology.

EDF (Kemp et al. 1992, https://www.edfplus.info) stores 16-bit samples at a constant rate. So the
recording's longest session is resampled at a constant rate on the sensing clock. Losses and events
become annotations, and the log gives the quantisation step of each signal.
"""

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from display_node.scoring.tracking_error import MAX_GAP_NS, interpolate
from protocol.config.quantities import count_text
from protocol.errors import OutputError, SourceError
from telepulse.recording.session import RecordedSession, felt_force, longest_session

SECOND_NS = 1_000_000_000
# The lowest code marks a missing value. A margin, as a share of the range, keeps values above it.
LOWEST_CODE, HIGHEST_CODE = -32_768, 32_767
RANGE_MARGIN = 0.02
LABEL_CHARACTERS = 16
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def export_edf(path: Path, file: Path) -> str:
    """Write a recording's forces into `file`, and return a line for the log.

    Raises SourceError or OutputError.
    """
    try:
        import edfio
    except ImportError as error:
        raise OutputError(
            f"an export to edf needs edfio, which cannot be loaded ({error});"
            " pip install 'telepulse[analysis]'"
        ) from None
    if file.exists():
        raise OutputError(f"{file}: exists already; name another by --out")
    session = longest_session(path)
    description = session.description
    period_ns = description.period_ns
    if period_ns > MAX_GAP_NS:
        slowest_hz = math.ceil(SECOND_NS / MAX_GAP_NS)
        raise SourceError(
            f"{path}: its rate is {description.rate_hz:g} Hz, below the {slowest_hz} Hz"
            " that EDF export needs; export it to csv"
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
    try:
        signals = [_signal(edfio, name, samples, rate_hz, unit) for name, samples, unit in forces]
    except ValueError as error:
        raise SourceError(f"{path}: holds forces that EDF cannot: {error}") from None
    losses = _losses(t_ns, numbers, period_ns)
    events = [(max(0, at_ns - begin_ns) * 1e-9, None, text) for at_ns, text in felt.events]
    missing_end = [(seconds, None, session.cut)] if session.cut else []
    origin = [
        (0, None, f"{key} {run[key]}")
        for run in session.provenance
        for key in ("version", "commit", "host", "command")
        if key in run
    ]
    notes = [edfio.EdfAnnotation(*note) for note in (*losses, *events, *missing_end, *origin)]
    unix_us = (begin_ns - felt.sensing_minus_unix_ns) // 1000
    start = datetime.fromtimestamp(unix_us / 1e6, UTC)
    edf = edfio.Edf(
        signals,
        recording=edfio.Recording(
            startdate=start.date(), equipment_code="telepulse", additional=("times_are_UTC",)
        ),
        starttime=start.time(),
        annotations=sorted(notes, key=lambda note: float(note.onset)),
    )
    try:
        edf.write(file)
    except OSError as error:
        raise OutputError(f"{file}: cannot be written: {error.strerror}") from None
    codes = HIGHEST_CODE - LOWEST_CODE
    steps = ", ".join(
        f"{one.label} {(one.physical_max - one.physical_min) / codes:.2g} {one.physical_dimension}"
        for one in signals
    )
    return (
        f"{file}: {seconds} s at {rate_hz} Hz, {count_text(len(losses), 'loss', 'losses')}"
        f" and {count_text(len(events), 'event')} as annotations; 16 bits;"
        f" quantisation steps: {steps}"
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


def _losses(t_ns: Ints, numbers: Ints, period_ns: int) -> list[tuple[float, float, str]]:
    """Return start and length in s of each gap in the sequence numbers, and its text."""
    return [
        (
            (int(t_ns[at] - t_ns[0]) + period_ns) * 1e-9,
            missing * period_ns * 1e-9,
            f"{count_text(missing, 'sample')} lost",
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


def _signal(edfio: Any, label: str, force_n: Floats, rate_hz: int, unit: str) -> Any:
    """Return a signal of forces in N in mN, or of an ECG in mV in uV."""
    force_mn = force_n * 1e3
    low, high = _range(force_mn[~np.isnan(force_mn)])
    return edfio.EdfSignal(
        np.where(np.isnan(force_mn), low, force_mn),
        rate_hz,
        label=label.encode("ascii", "replace").decode()[:LABEL_CHARACTERS],
        physical_dimension=unit,
        physical_range=(low, high),
        digital_range=(LOWEST_CODE, HIGHEST_CODE),
    )


def _range(force_mn: Floats) -> tuple[float, float]:
    """Return limits just outside the values; each fits the 8 characters of an EDF header."""
    if not len(force_mn):
        return -1.0, 1.0
    low, high = float(force_mn.min()), float(force_mn.max())
    width = max(high - low, 1e-3, 1e-4 * abs(low), 1e-4 * abs(high))
    power = math.floor(math.log10(width))
    unit, digits = 10.0 ** (power - 1), max(0, 1 - power)
    low = math.floor((low - RANGE_MARGIN * width) / unit) * unit
    high = math.ceil((high + RANGE_MARGIN * width) / unit) * unit
    return round(low, digits), round(high, digits)
