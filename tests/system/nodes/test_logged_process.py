"""The log of a process that another one runs."""

import logging

import pytest

from protocol.errors import ProcessError
from telepulse.processes import LoggedProcess

ENDS_WITHIN_S = 30.0
PROGRAM = """
import logging, sys
from protocol.host.output import FAULT, configure_logging
configure_logging()
logger = logging.getLogger("protocol")
logger.info("all is well")
logger.warning("fault: is what this warning begins with")
print("a line of a library", file=sys.stderr)
logger.error("film: feedback lost", extra={FAULT: True})
logger.error("no board")
sys.exit({status})
"""


def warnings(caplog: pytest.LogCaptureFixture) -> list[tuple[int, str]]:
    return [
        (record.levelno, record.getMessage())
        for record in caplog.records
        if record.name == "telepulse.processes"
    ]


def test_warnings_of_a_process_are_logged_whatever_their_words_and_faults_are_not(
    caplog: pytest.LogCaptureFixture,
) -> None:
    with LoggedProcess("node", "-c", PROGRAM.replace("{status}", "0")) as process:
        printed = process.await_end(ENDS_WITHIN_S)
    assert warnings(caplog) == [
        (logging.WARNING, "node: fault: is what this warning begins with"),
        (logging.ERROR, "node: no board"),
    ]
    assert "a line of a library\n" in printed
    assert "film: feedback lost\n" in printed


def test_a_process_that_fails_is_named_with_its_last_line() -> None:
    with (
        LoggedProcess("node", "-c", PROGRAM.replace("{status}", "5")) as process,
        pytest.raises(ProcessError, match=r"^the node ended with status 5: no board$"),
    ):
        process.await_end(ENDS_WITHIN_S)
