"""The formats of files of signals, and the checks that hold for all of them."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from protocol.errors import SourceError
from sensing_node.files.bounds import check_regular
from sensing_node.files.signals import ColumnKey, SignalFile, clean, rate_fault

MOST_NOTES = 10


class FileFormat(NamedTuple):
    """A format: its name, the suffixes of its files, the module in this package that reads it.

    extra: extra of telepulse that installs the library which the module imports, if a plain
    installation lacks it.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    extra: str = ""


FORMATS = (
    FileFormat("CSV", (".csv", ".txt", ".tsv", ".log"), "csv_table"),
    FileFormat("NumPy", (".npy", ".npz"), "numpy_arrays"),
    FileFormat("MATLAB", (".mat",), "matlab"),
    FileFormat("WFDB", (".hea", ".dat"), "wfdb_record"),
    FileFormat("EDF+ or BDF", (".edf", ".bdf"), "edf"),
    FileFormat("XDF", (".xdf",), "xdf", "files"),
    FileFormat("MCAP", (".mcap",), "mcap_messages", "files"),
    FileFormat("Parquet", (".parquet",), "parquet", "files"),
    FileFormat("WAV", (".wav",), "wav"),
)


def format_of(path: Path) -> FileFormat:
    """Return the format of a file by its suffix; without one, of a WFDB record beside its name.

    Raises SourceError.
    """
    suffix = path.suffix.lower()
    # PhysioNet keeps samples in files of MATLAB, too.
    record = suffix == ".mat" and path.with_suffix(".hea").exists()
    if record or path.with_name(f"{path.name}.hea").exists():
        return next(known for known in FORMATS if known.name == "WFDB")
    for known in FORMATS:
        if suffix in known.suffixes:
            return known
    suffixes = ", ".join(suffix for known in FORMATS for suffix in known.suffixes)
    named = f"{suffix} is none of" if suffix else "its name lacks a suffix, one of"
    raise SourceError(f"{path}: {named} {suffixes}, and there is no record {path.name}.hea")


def open_signals(path: Path) -> SignalFile:
    """Open a file of signals. Raises SourceError, one line whatever is wrong with the file.

    Its signals have rates within the limits and names in one printable line. Values that are not
    finite are missing samples, NaN.
    """
    check_regular(path)
    chosen = format_of(path)
    with _one_line(path, chosen):
        if path.is_file() and not path.stat().st_size:
            raise SourceError(f"{path}: is empty")
        file: SignalFile = import_module(f"{__package__}.{chosen.module}").read(path)
    left_out: dict[ColumnKey, str] = {clean(str(n)): r for n, r in file.left_out.items()}
    signals, numbers = [], dict[ColumnKey, str]()
    for signal in file.signals:
        named = signal._replace(name=clean(signal.name), unit=clean(signal.unit))
        if (fault := rate_fault(signal.rate_hz)) is None:
            signals.append(named)
        else:
            left_out[named.name] = numbers[named.number] = fault
    if not signals:
        reasons = (f"signal {name!r} {reason}" for name, reason in left_out.items())
        raise SourceError(f"{path}: {next(reasons, 'holds no signal of numbers')}")
    notes = [f"left out: signal {name!r} {reason}" for name, reason in left_out.items()]
    if len(notes) > MOST_NOTES:
        notes[MOST_NOTES:] = [f"left out: {len(notes) - MOST_NOTES} further signals"]

    return replace(
        file,
        signals=tuple(signals),
        notes=(*map(clean, file.notes), *notes),
        left_out=left_out | numbers,
        guard=partial(_one_line, path, chosen),
    )


@contextmanager
def _one_line(path: Path, chosen: FileFormat) -> Iterator[None]:
    try:
        yield
    except SourceError as error:
        raise SourceError(clean(str(error))) from None
    except ImportError as error:
        package = f"'telepulse[{chosen.extra}]'" if chosen.extra else error.name
        raise SourceError(
            f"{path}: reading {chosen.name} needs {error.name}, which cannot be loaded ({error});"
            f" pip install {package}"
        ) from None
    except FileNotFoundError as error:
        named = Path(error.filename or path).name
        lacks = "no such recording" if named == path.name else f"its file {named} is missing"
        raise SourceError(f"{path}: {lacks}") from None
    except (LookupError, TypeError, AttributeError, NameError, ArithmeticError):
        # A library that meets what it does not expect: its words say nothing to a person.
        raise SourceError(f"{path}: is damaged, or is no {chosen.name} file") from None
    except Exception as error:  # libraries raise many kinds for a damaged file
        lines = str(getattr(error, "strerror", None) or error).splitlines()
        reason = lines[0][:200] if lines else type(error).__name__
        raise SourceError(f"{path}: cannot be read: {reason}") from None
