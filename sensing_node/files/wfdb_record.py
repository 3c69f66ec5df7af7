"""WFDB records, as those of PhysioNet: a header NAME.hea, and files of samples that it names.

This module reads the storage formats below without the package wfdb, which needs a dozen further
packages. The format is that of header(5) and signal(5) in the WFDB Applications Guide,
https://physionet.org/physiotools/wag/.
"""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.errors import SourceError
from sensing_node.files.bounds import check_regular, check_samples, read_whole
from sensing_node.files.signals import Floats, SignalFile, SignalInfo, text_encoding

Ints = NDArray[np.int64]
DEFAULT_GAIN = 200.0
# Bits and code of a missing sample of each storage format.
FORMATS = {
    **{"16": (16, -(1 << 15)), "61": (16, -(1 << 15)), "160": (16, -(1 << 15))},
    **{"24": (24, -(1 << 23)), "32": (32, -(1 << 31)), "80": (8, -128), "212": (12, -(1 << 11))},
}
MOST_SEGMENTS = 100_000
_STORAGE = re.compile(r"(\d+)(?:x(\d{1,5}))?(?::(\d{1,9}))?(?:\+(\d{1,12}))?")
_GAIN = re.compile(r"([-+.\deE]+)(?:\((-?\d+)\))?(?:/(\S+))?")


class StoredSignal(NamedTuple):
    """A signal line of a header: where its samples are, and how they are scaled.

    per_frame: samples in a frame. skew: frames by which the samples come later in the file.
    """

    file: str
    code: str
    per_frame: int
    skew: int
    offset_bytes: int
    gain: float
    baseline: int
    unit: str
    name: str


class RecordHeader(NamedTuple):
    """A header. frames: 0 where it states none. segments: names and frames of a record's parts."""

    rate_hz: float
    frames: int
    signals: tuple[StoredSignal, ...]
    segments: tuple[tuple[str, int], ...]


def read(path: Path) -> SignalFile:
    """Open a record by its header, a file of samples, or its name alone. Raises SourceError."""
    path = _header_of(path)
    header = _read_header(path)
    parts = [(header, 0)] if not header.segments else list(_segments(path, header))
    stored = {signal.name: signal for part, _ in parts for signal in part.signals}
    described = header.signals or tuple(stored.values())
    frames = max((at + _frames(path, part) for part, at in parts), default=0)
    if not frames:
        raise SourceError(f"{path}: its files hold no whole sample")
    check_samples(path, frames * max(each.per_frame for each in described))
    lacks = (
        f"the header states {header.frames} samples, and the files hold {frames}; the rest is"
        " missing"
    )
    signals = [
        SignalInfo(number, each.name, each.unit, header.rate_hz * each.per_frame,
                   frames * each.per_frame)
        for number, each in enumerate(described)
    ]  # fmt: skip

    def values(wanted: int) -> Floats:
        name, per_frame = described[wanted].name, described[wanted].per_frame
        whole = np.full(frames * per_frame, np.nan)
        for part, at in parts:
            for number, each in enumerate(part.signals):
                if each.name == name and (header.segments or number == wanted):
                    if each.per_frame != per_frame:
                        raise SourceError(f"{path}: {name} changes its rate in a segment")
                    taken = _physical(path, part, number)[: len(whole) - at * per_frame]
                    whole[at * per_frame :][: len(taken)] = taken
                    break
        return whole

    return SignalFile(path, tuple(signals), values, (lacks,) if frames < header.frames else ())


def _header_of(path: Path) -> Path:
    """Return the path of a record's header, from that of either file or without a suffix."""
    whole = path.suffix.lower() in (".hea", ".dat", ".mat")
    return path.with_suffix(".hea") if whole else path.with_name(f"{path.name}.hea")


def _read_header(path: Path) -> RecordHeader:
    """Read a header. Raises SourceError or OSError."""
    text = read_whole(path).decode(text_encoding(path), "replace")
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    if not lines:
        raise SourceError(f"{path}: is no header of a WFDB record: it holds no line")
    try:
        name, count, *rest = lines[0].split()
        _, _, segments = name.partition("/")
        rate_hz = float(re.split(r"[/(]", rest[0])[0]) if rest else 250.0
        frames = int(rest[1]) if len(rest) > 1 else 0
        expected = int(segments) if segments else int(count)
        if len(lines) - 1 < expected or not 0 <= expected <= MOST_SEGMENTS or frames < 0:
            raise SourceError(
                f"{path}: its first line announces {expected} lines, and {len(lines) - 1} follow"
            )
        described = lines[1 : 1 + expected]
        if segments:
            parts = tuple(_segment(line) for line in described)
            return RecordHeader(rate_hz, frames, (), parts)
        signals = tuple(_signal(line, number) for number, line in enumerate(described))
    except (ValueError, IndexError, OverflowError) as error:
        raise SourceError(f"{path}: is no header of a WFDB record: {error}") from None
    return RecordHeader(rate_hz, frames, signals, ())


def _segment(line: str) -> tuple[str, int]:
    name, frames = line.split()[:2]
    if int(frames) < 0:
        raise ValueError(f"a segment of {frames} samples")
    return name, int(frames)


def _signal(line: str, number: int) -> StoredSignal:
    """Read a signal line. Raises ValueError."""
    parts = line.split(maxsplit=8)
    if len(parts) < 2 or (storage := _STORAGE.fullmatch(parts[1])) is None:
        raise ValueError(f"{line[:60]!r} is no line of a signal")
    code, per_frame, skew, offset = (storage[at] for at in range(1, 5))
    scale = _GAIN.fullmatch(parts[2]) if len(parts) > 2 else None
    if len(parts) > 2 and scale is None:
        raise ValueError(f"{parts[2][:40]!r} is no gain")
    gain = float(scale[1]) if scale else 0.0
    zero = int(parts[4]) if len(parts) > 4 else 0
    return StoredSignal(
        parts[0],
        code,
        int(per_frame or 1),
        int(skew or 0),
        int(offset or 0),
        gain or DEFAULT_GAIN,
        int(scale[2]) if scale and scale[2] else zero,
        (scale and scale[3]) or "mV",
        parts[8].strip() if len(parts) > 8 else f"signal {number}",
    )


def _segments(path: Path, header: RecordHeader) -> Iterator[tuple[RecordHeader, int]]:
    """Yield the parts of a record, and the frame at which each begins. Raises SourceError."""
    at = 0
    for name, frames in header.segments:
        if name != "~" and frames:
            part = _read_header(_beside(path, f"{name}.hea"))
            if part.segments or part.rate_hz != header.rate_hz:
                raise SourceError(f"{path}: segment {name} has segments or another rate")
            yield part._replace(frames=frames), at
        at += frames


def _beside(path: Path, name: str) -> Path:
    """Return the path of a file that a header names. Raises SourceError for another folder."""
    if "/" in name or "\\" in name:
        raise SourceError(f"{path}: names {name[:80]!r}, which is not in its own folder")
    return path.with_name(name)


def _in_file(header: RecordHeader, number: int) -> tuple[list[StoredSignal], int]:
    """Return the signals that share a signal's file, and its place in their frame."""
    own = header.signals[number]
    together = [each for each in header.signals if each.file == own.file]
    before = sum(each.per_frame for each in header.signals[:number] if each.file == own.file)
    return together, before


def _frames(path: Path, header: RecordHeader) -> int:
    """Return the number of whole frames that all files of a header hold, or that it states."""
    counts = []
    for number, signal in enumerate(header.signals):
        if signal.code not in FORMATS:
            raise SourceError(
                f"{path}: signal {signal.name!r} is stored in format {signal.code}; formats"
                f" {', '.join(FORMATS)} are read: convert it by the package wfdb"
            )
        together, _ = _in_file(header, number)
        width = sum(each.per_frame for each in together)
        if not width:
            raise SourceError(f"{path}: {signal.file} has no samples in a frame")
        check_regular(_beside(path, signal.file))
        size = _beside(path, signal.file).stat().st_size - signal.offset_bytes
        counts.append(max(0, size) * 8 // FORMATS[signal.code][0] // width)
    held = min(counts, default=0)
    return min(held, header.frames) if header.frames else held


def _physical(path: Path, header: RecordHeader, number: int) -> Floats:
    """Return the samples of a signal in its unit, NaN where missing."""
    signal, frames = header.signals[number], _frames(path, header)
    together, before = _in_file(header, number)
    width = sum(each.per_frame for each in together)
    bits, missing = FORMATS[signal.code]
    # Skewed samples follow the last frame.
    count = (frames + signal.skew) * width
    with _beside(path, signal.file).open("rb") as file:
        file.seek(signal.offset_bytes)
        data = np.frombuffer(file.read((count * bits + 7) // 8), np.uint8)
    codes = _decode(data, signal.code, before, signal.per_frame, width)
    codes = codes[signal.skew * signal.per_frame :][: frames * signal.per_frame]
    values = (codes - signal.baseline) / signal.gain
    values[codes == missing] = np.nan
    return np.pad(values, (0, frames * signal.per_frame - len(values)), constant_values=np.nan)


def _decode(data: NDArray[np.uint8], code: str, first: int, count: int, width: int) -> Ints:
    """Return the codes at `first` to `first + count` of each frame of `width` samples."""
    if code == "212":
        data = np.pad(data, (0, -len(data) % 3))
        one, two, three = data.reshape(-1, 3).astype(np.int16).T
        samples = np.stack([one | (two & 0x0F) << 8, three | (two & 0xF0) << 4], axis=1).ravel()
        samples = np.where(samples > 2047, samples - 4096, samples)
    elif code == "24":
        bytes_3 = data[: len(data) // 3 * 3].reshape(-1, 3)
        wide = np.pad(bytes_3, ((0, 0), (1, 0)))
        samples = np.ascontiguousarray(wide).view("<i4").ravel() >> 8
    else:
        kind = {"16": "<i2", "61": ">i2", "160": "<u2", "32": "<i4", "80": "u1"}[code]
        size = np.dtype(kind).itemsize
        samples = data[: len(data) // size * size].view(kind)
    frames = samples[: len(samples) // width * width].reshape(-1, width)
    chosen = frames[:, first : first + count].ravel().astype(np.int64)
    return chosen - {"160": 1 << 15, "80": 128}.get(code, 0)
