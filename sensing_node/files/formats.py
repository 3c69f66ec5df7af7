"""The formats of files of signals: one table for sources, `telepulse convert` and exports."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from protocol.errors import OutputError, SourceError
from pulse_sensors.plausibility import RecordedColumn
from sensing_node.files.signals import (
    ColumnKey,
    SignalFile,
    SignalReader,
    SignalTable,
    SignalWriter,
)


class FileFormat(NamedTuple):
    """A format: its name, the suffixes of its files, the module in this package that reads it.

    extra: extra of telepulse that installs the library which the module imports. written: suffixes
    of files that it also writes.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    extra: str = ""
    written: tuple[str, ...] = ()


FORMATS = (
    FileFormat("CSV", (".csv", ".txt"), "columns", written=(".csv",)),
    FileFormat("NumPy", (".npy", ".npz"), "columns", written=(".npz",)),
    FileFormat("WFDB", (".hea", ".dat"), "wfdb_record", written=(".hea",)),
    FileFormat("EDF+ or BDF", (".edf", ".bdf"), "edf", "analysis", (".edf", ".bdf")),
    FileFormat("XDF", (".xdf",), "xdf", "files", (".xdf",)),
    FileFormat("MCAP", (".mcap",), "mcap_messages", "files"),
    FileFormat("Parquet", (".parquet",), "parquet", "files", (".parquet",)),
    FileFormat("WAV", (".wav",), "wav", written=(".wav",)),
)


def format_of(path: Path) -> FileFormat:
    """Return the format of a file by its suffix; without one, of a WFDB record beside its name.

    Raises SourceError.
    """
    suffix = path.suffix.lower()
    for known in FORMATS:
        if suffix in known.suffixes:
            return known
    if path.with_name(f"{path.name}.hea").exists():
        return next(known for known in FORMATS if known.name == "WFDB")
    suffixes = ", ".join(suffix for known in FORMATS for suffix in known.suffixes)
    raise SourceError(f"{path}: {suffix or 'no suffix'} is none of {suffixes}")


def open_signals(path: Path) -> SignalFile:
    """Open a file of signals. Raises SourceError, one line whatever is wrong with the file."""
    chosen = format_of(path)
    with _one_line(path, chosen):
        read: SignalReader = import_module(f"{__package__}.{chosen.module}").read
        file = read(path)

    def load(keys: Sequence[ColumnKey]) -> list[RecordedColumn]:
        with _one_line(path, chosen):
            return file.load(keys)

    return replace(file, load=load)


def write_signals(path: Path, table: SignalTable, suffix: str | None = None) -> list[str]:
    """Write signals into a new file, in the format of its suffix or of the given one.

    Returns
    -------
    list of str
        What the format could not hold.

    Raises
    ------
    OutputError
        If the file exists already or cannot be written, or its format is not written.
    """
    suffix = suffix or path.suffix.lower()
    chosen = next((known for known in FORMATS if suffix in known.written), None)
    if chosen is None:
        suffixes = ", ".join(suffix for known in FORMATS for suffix in known.written)
        raise OutputError(f"{path}: {suffix or 'no suffix'} is none of {suffixes}")
    if path.exists():
        raise OutputError(f"{path}: exists already; name another file")
    try:
        write: SignalWriter = import_module(f"{__package__}.{chosen.module}").write
        return write(path, table)
    except ImportError as error:
        raise OutputError(
            f"{path}: writing {chosen.name} needs {error.name}, which cannot be loaded ({error});"
            f" pip install 'telepulse[{chosen.extra}]'"
        ) from None
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror or error}") from None
    except ValueError as error:
        raise OutputError(f"{path}: cannot hold these signals: {error}") from None


@contextmanager
def _one_line(path: Path, chosen: FileFormat) -> Iterator[None]:
    try:
        yield
    except SourceError:
        raise
    except ImportError as error:
        raise SourceError(
            f"{path}: reading {chosen.name} needs {error.name}, which cannot be loaded ({error});"
            f" pip install 'telepulse[{chosen.extra}]'"
        ) from None
    except FileNotFoundError as error:
        named = Path(error.filename or path).name
        lacks = "no such recording" if named == path.name else f"its file {named} is missing"
        raise SourceError(f"{path}: {lacks}") from None
    except Exception as error:  # libraries raise many kinds for a damaged file
        lines = str(getattr(error, "strerror", None) or error).splitlines()
        reason = lines[0][:200] if lines else type(error).__name__
        raise SourceError(f"{path}: cannot be read: {reason}") from None
