"""Export of signals as a WFDB record in storage format 16, as header(5) describes it.

https://physionet.org/physiotools/wag/header-5.htm
"""

import re
from pathlib import Path

import numpy as np

from protocol.config.quantities import count_text
from telepulse.recording.signal_table import SignalTable, plain_micro

# Code of a missing sample, and the greatest one that is written.
MISSING, HIGHEST_CODE = -(1 << 15), 32_000


def write(path: Path, table: SignalTable) -> list[str]:
    """Write NAME.hea, and NAME.dat beside it; see `SignalWriter`."""
    head = path.with_suffix(".hea") if path.suffix == ".hea" else path.with_name(f"{path.name}.hea")
    name, data = head.stem, head.with_suffix(".dat")
    if re.fullmatch(r"[\w-]+", name, re.ASCII) is None:
        raise ValueError(f"a record's name has letters, digits, _ and -, not {name!r}")
    notes: list[str] = []
    samples, count = table.values.shape
    lines = [f"{name} {count} {table.rate_hz} {samples} {table.begin:%H:%M:%S.%f %d/%m/%Y}"]
    codes = np.full(table.values.shape, MISSING, "<i2")
    for column, values in enumerate(table.values.T):
        known = values[~np.isnan(values)]
        low, high = (float(known.min()), float(known.max())) if len(known) else (-1.0, 1.0)
        middle, half = (low + high) / 2, max((high - low) / 2, 1e-9 * max(abs(low), abs(high), 1))
        gain = float(f"{HIGHEST_CODE / half:.6g}")
        baseline = -round(middle * gain)
        codes[~np.isnan(values), column] = (np.rint(known * gain) + baseline).astype("<i2")
        check = int(codes[:, column].sum(dtype=np.int64)) & 0xFFFF
        # Other readers drop what is not ASCII: from µN, they would read N.
        title, unit = plain_micro(table.names[column]), plain_micro(table.units[column])
        lines.append(
            f"{data.name} 16 {gain!r}({baseline})/{unit} 16 0 {codes[0, column]}"
            f" {check - 0x10000 if check > 0x7FFF else check} 0 {title}"
        )
        notes.append(f"{table.names[column]} in steps of {1 / gain:.2g} {unit}")
    for key, text in table.about.items():
        lines += [f"# {key}: {line}" for line in text.splitlines()]
    with data.open("xb") as file:
        file.write(codes.tobytes())
    with head.open("x", encoding="utf-8") as header:
        header.write("\n".join(lines) + "\n")
    left_out = count_text(len(table.annotations), "annotation is", "annotations are")
    return [*notes, f"{left_out} left out"] if table.annotations else notes
