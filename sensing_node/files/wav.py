"""WAV files: one signal a channel, without a unit; integers are scaled to -1 to 1."""

import io
import warnings
from pathlib import Path

import numpy as np
from scipy.io import wavfile

from protocol.errors import SourceError
from sensing_node.files.bounds import check_samples, read_whole
from sensing_node.files.signals import Floats, SignalFile, SignalInfo


def read(path: Path) -> SignalFile:
    """Open a WAV file. Raises SourceError, and other errors for a damaged file."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        # From memory, so that a damaged length allocates no more than the file has.
        rate_hz, data = wavfile.read(io.BytesIO(read_whole(path)))
    if data.ndim == 1:
        data = data[:, np.newaxis]
    if data.ndim != 2 or not len(data):
        raise SourceError(f"{path}: holds no sample")
    check_samples(path, len(data))
    # Of more bits than 16, scipy returns those of 24 in the upper ones of 32.
    scale = 1.0 if data.dtype.kind == "f" else float(1 << (8 * data.dtype.itemsize - 1))
    zero = 128.0 if data.dtype == np.uint8 else 0.0

    def values(number: int) -> Floats:
        one: Floats = (data[:, number].astype(np.float64) - zero) / scale
        return one

    signals = tuple(
        SignalInfo(number, f"channel {number}", "", float(rate_hz), len(data))
        for number in range(data.shape[1])
    )
    notes = tuple(str(each.message).splitlines()[0] for each in caught)
    return SignalFile(path, signals, values, notes)
