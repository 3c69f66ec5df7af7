import logging
import re

import pytest

from protocol.errors import OptionError
from protocol.host.output import configure_logging

ours, library = logging.getLogger("sensing_node.node"), logging.getLogger("zeroconf")


def test_a_record_is_one_line_with_time_and_level_whatever_it_holds(
    capsys: pytest.CaptureFixture[str],
) -> None:
    configure_logging()
    ours.warning("anna\n12:00:00.000 ERROR \x1b[31mfault joined, 100 %")
    line = capsys.readouterr().err
    assert re.fullmatch(
        r"\d\d:\d\d:\d\d\.\d{3} WARNING anna\\n12:.*\\x1b\[31mfault.* 100 %\n", line
    )


def test_an_exception_is_named_in_the_same_line(capsys: pytest.CaptureFixture[str]) -> None:
    configure_logging()
    try:
        raise ValueError("no\nsuch")
    except ValueError:
        library.exception("failed")
    line = capsys.readouterr().err
    assert re.search(r" ERROR failed: ValueError: no\\nsuch \(.*test_output.py:\d+\)\n$", line)


@pytest.mark.parametrize(
    ("level", "quiet", "levels", "library_levels"),
    [
        (None, False, "INFO WARNING ERROR", "WARNING ERROR"),
        (None, True, "WARNING ERROR", "WARNING ERROR"),
        ("debug", True, "DEBUG INFO WARNING ERROR", "WARNING ERROR"),
        ("error", False, "ERROR", "ERROR"),
    ],
)
def test_levels_of_ours_and_of_libraries(
    level: str | None,
    quiet: bool,
    levels: str,
    library_levels: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    configure_logging("debug")
    configure_logging(level, quiet)
    for logger, expected in ((ours, levels), (library, library_levels)):
        for number in (logging.DEBUG, logging.INFO, logging.WARNING, logging.ERROR):
            logger.log(number, "message")
        assert [
            line.split()[1] for line in capsys.readouterr().err.splitlines()
        ] == expected.split()


def test_an_unknown_level_is_refused() -> None:
    with pytest.raises(
        OptionError, match="--log-level loud: there are debug, info, warning, error"
    ):
        configure_logging("loud")
