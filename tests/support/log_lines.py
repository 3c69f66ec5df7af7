"""The log of a program of ours, as it is on its standard error."""

import re

from tests.support.nodes import run

_RECORD = re.compile(r"^\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3} (?P<level>[A-Z]+) (?P<message>.*)$")
USUAL = ("DEBUG", "INFO")


def messages(errors: str) -> list[str]:
    """Return the messages of the records in a standard error, in order."""
    found = map(_RECORD.match, errors.splitlines())
    return [record["message"] for record in found if record is not None]


def unusual(errors: str) -> str:
    """Return the lines of a standard error that are no record of level info or below."""
    return "".join(
        line
        for line in errors.splitlines(keepends=True)
        if (record := _RECORD.match(line)) is None or record["level"] not in USUAL
    )


def strays(errors: str) -> str:
    """Return the lines of a standard error that are no record of the log."""
    return "".join(line for line in errors.splitlines(keepends=True) if _RECORD.match(line) is None)


def refused(module: str, *arguments: str) -> str:
    """Return the one line in which a module of ours refuses a command line."""
    result = run(module, *arguments)
    found = (result.returncode, result.stdout, result.stderr.count("\n"))
    assert found == (2, "", 1), result.stderr
    return result.stderr
