"""Output files of commands: checked before a run, written whole or not at all."""

import os
import secrets
import stat
from contextlib import suppress
from pathlib import Path

from protocol.errors import OutputError


def check_writable(path: Path | None) -> None:
    """Check before a run that its result can be written to `path`; None is no file.

    A file of that name is left as it is. Raises OutputError.
    """
    if path is None:
        return
    if not path.parent.is_dir():
        raise OutputError(f"{path}: cannot be written: the folder {path.parent} does not exist")
    try:
        if _is_special(path):
            # Opening a pipe would wait for its reader.
            writable = os.access(path, os.W_OK)
        else:
            _draft(path).unlink()
            writable = not path.exists() or os.access(path, os.W_OK)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {_reason(error)}") from None
    if not writable:
        raise OutputError(f"{path}: cannot be written: it is read-only")


def write_whole(path: Path, text: str) -> None:
    """Write a text file in one step: a reader finds the old file or the whole new one.

    A pipe or a device is written to directly. Raises OutputError.
    """
    try:
        if _is_special(path):
            path.write_text(text, encoding="utf-8")
            return
        draft = _draft(path)
        try:
            with draft.open("w", encoding="utf-8") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(path.resolve())
        except BaseException:
            with suppress(FileNotFoundError):
                draft.unlink()
            raise
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {_reason(error)}") from None


def create_file(path: Path, text: str) -> None:
    """Write a new text file. Raises OutputError, also where there is a file of that name."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise OutputError(f"{path}: is there already; name another file") from None
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {_reason(error)}") from None


def _is_special(path: Path) -> bool:
    """Return whether there is a pipe or a device. Raises OSError for a folder."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return False
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(0, "it is a folder")
    return not stat.S_ISREG(mode)


def _draft(path: Path) -> Path:
    """Return a new, empty file beside `path`, with the permissions of `path`."""
    target = path.resolve()
    draft = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    draft.open("xb").close()
    if target.exists():
        draft.chmod(stat.S_IMODE(target.stat().st_mode))
    return draft


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
