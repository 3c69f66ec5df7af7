"""Records of PhysioNet with an ECG, a pulse and annotated beats, read by the package wfdb.

The records are those of wfdb's sample data (https://github.com/MIT-LCP/wfdb-python), which contain
100 of the MIT-BIH Arrhythmia Database, 03700181 of MIMIC, and a103l of the challenge of 2015.
"""

from pathlib import Path
from typing import Any

import numpy as np

from protocol.errors import SourceError
from tests.support.announced_pulses import AnnouncedPulse
from tests.support.drawn_pulses import RATE_HZ, SCORED_FROM_S, Floats, Pulse
from tests.support.r_wave_scores import AnnotatedLead

# Record, ECG and pulse.
ANNOUNCED = (("03700181", "MCL1", "ABP"), ("a103l", "II", "PLETH"))
ANNOTATED = (("100", "atr"),)
# Symbols of beats among the annotations.
BEATS = frozenset("NLRBAaJSVrFejnE/fQ?")


def recorded_announced(folder: Path, seconds: float) -> list[AnnouncedPulse]:
    """Return the first seconds of each record with a pulse, at 1 kHz. Raises SourceError."""
    made = []
    for name, ecg, pulse in ANNOUNCED:
        rate_hz, signals = _read(folder, name, seconds)
        t_s = np.arange(len(signals[ecg])) / rate_hz
        at_s = np.arange(0, t_s[-1], 1 / RATE_HZ)
        ecg_mv, wave = (np.interp(at_s, t_s, signals[each]) for each in (ecg, pulse))
        wave = wave / wave[round(SCORED_FROM_S * RATE_HZ) :].std()
        made.append(AnnouncedPulse(Pulse(f"{name}, {ecg} and {pulse}", wave, wave), ecg_mv))
    return made


def annotated_leads(folder: Path) -> list[AnnotatedLead]:
    """Return every lead of the records with annotations by cardiologists. Raises SourceError."""
    made = []
    for name, extension in ANNOTATED:
        rate_hz, signals = _read(folder, name)
        found = _wfdb().rdann(str(folder / name), extension)
        beat = [symbol in BEATS for symbol in found.symbol]
        beats_s = np.asarray(found.sample)[beat] / rate_hz
        made += [
            AnnotatedLead(f"{name}, {lead}", rate_hz, ecg, beats_s) for lead, ecg in signals.items()
        ]
    return made


def _read(folder: Path, name: str, seconds: float | None = None) -> tuple[float, dict[str, Floats]]:
    """Return a record's rate and its signals by name, missing samples interpolated."""
    wfdb = _wfdb()
    try:
        header = wfdb.rdheader(str(folder / name))
        last = None if seconds is None else round(seconds * header.fs)
        values, fields = wfdb.rdsamp(str(folder / name), sampto=last)
    except (OSError, ValueError) as error:
        raise SourceError(f"{folder / name}: cannot be read as a WFDB record: {error}") from None
    signals = {}
    for column, signal in enumerate(fields["sig_name"]):
        row = np.asarray(values[:, column], float)
        known = np.flatnonzero(np.isfinite(row))
        signals[signal] = np.interp(np.arange(len(row)), known, row[known])
    return float(fields["fs"]), signals


def _wfdb() -> Any:
    try:
        import wfdb
    except ImportError:
        raise SourceError("records of PhysioNet need wfdb: pip install 'telepulse[ecg]'") from None
    return wfdb
