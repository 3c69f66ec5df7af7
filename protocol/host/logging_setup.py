"""Logging of a program: one handler that writes one line a record to standard error.

A line is `HH:MM:SS.mmm LEVEL message` in local time. The handler writes to whatever `sys.stderr` is
at that moment, so that within `unblocked_output` a record is queued and never holds up a loop.
"""

import logging
import sys
import time
import traceback
from contextlib import suppress
from typing import Any

from protocol.errors import OptionError

LEVELS = {
    "debug": logging.DEBUG,
    "info": logging.INFO,
    "warning": logging.WARNING,
    "error": logging.ERROR,
}
# What canopen logs, the drive raises or counts.
SILENCED = ("canopen",)
# A module that is run by `python -m` logs as `__main__`.
OUR_LOGGERS = (
    *("protocol", "pulse_sensors", "sensing_node", "display_node", "telepulse"),
    "__main__",
)


class LineFormatter(logging.Formatter):
    """Format a record as one line, whatever its message holds."""

    def format(self, record: logging.LogRecord) -> str:
        """Return `HH:MM:SS.mmm LEVEL message`; control characters are escaped."""
        at = time.strftime("%H:%M:%S", time.localtime(record.created))
        text = _printable(record.getMessage())
        line = f"{at}.{int(record.msecs):03d} {record.levelname} {text}"
        return line if record.exc_info is None else f"{line}: {_error(record.exc_info)}"


def _printable(text: str) -> str:
    return "".join(
        each if each.isprintable() else each.encode("unicode_escape").decode("ascii")
        for each in text
    )


def _error(raised: Any) -> str:
    """Return an exception and the innermost line that raised it, as one line."""
    kind, error, trace = raised
    at = traceback.extract_tb(trace)[-1:]
    where = f" ({at[0].filename}:{at[0].lineno})" if at else ""
    return _printable(f"{getattr(kind, '__name__', kind)}: {error}{where}")


class StderrHandler(logging.Handler):
    """Write records to the present `sys.stderr`."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line; a reader that has gone is no error of the program's."""
        with suppress(OSError, ValueError):
            sys.stderr.write(self.format(record) + "\n")


def configure_logging(level: str | None = None, quiet: bool = False) -> None:
    """Log to standard error from `level` on; call it again to change the level.

    Parameters
    ----------
    level
        One of `LEVELS`. None: "warning" where `quiet`, else "info".
    quiet
        Whether the program was asked to be quiet.

    Raises
    ------
    OptionError
        Where there is no such level.
    """
    name = level or ("warning" if quiet else "info")
    if name not in LEVELS:
        raise OptionError(f"--log-level {name}: there are {', '.join(LEVELS)}")
    root = logging.getLogger()
    handler = next((each for each in root.handlers if isinstance(each, StderrHandler)), None)
    if handler is None:
        handler = StderrHandler()
        handler.setFormatter(LineFormatter())
        root.addHandler(handler)
    # Some libraries set the level of their own logger when they are imported.
    handler.setLevel(LEVELS[name])
    # Libraries log by their own terms: only what is wrong is of use here.
    root.setLevel(max(LEVELS[name], logging.WARNING))
    for silenced in SILENCED:
        logging.getLogger(silenced).setLevel(logging.CRITICAL)
    for ours in OUR_LOGGERS:
        logging.getLogger(ours).setLevel(LEVELS[name])
