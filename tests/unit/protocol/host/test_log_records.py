"""Records of a log that another program reads."""

import logging

import pytest

from protocol.host.output import JsonFormatter, read_record


@pytest.mark.parametrize("line", ["", "12:00:00.000 WARNING x", "[]", '{"level": "LOUD"}', "4"])
def test_another_line_is_no_record(line: str) -> None:
    assert read_record(line) is None


def test_a_record_is_read_as_it_was_written() -> None:
    record = logging.LogRecord("a", logging.ERROR, "", 0, "two\nlines %s", ("ü",), None)
    found = read_record(JsonFormatter().format(record))
    assert found == (logging.ERROR, "two\nlines ü", False)
