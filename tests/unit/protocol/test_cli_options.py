import signal
from collections.abc import Iterator

import pytest

from protocol.cli_options import one_line_errors
from protocol.errors import (
    AddressError,
    OutputError,
    SceneError,
    SourceError,
    TelepulseError,
    WireError,
)
from protocol.host.process import stop_on_signals


@pytest.mark.parametrize(
    "error",
    [
        TelepulseError("of any kind"),
        SceneError("x.toml: no such scene file"),
        WireError("truncated", "the message ends too early"),
        AddressError("cannot bind tcp://127.0.0.1:5555"),
        SourceError("x.csv: no such recording"),
        OutputError("x.json: cannot be written: No space left on device"),
    ],
)
def test_our_own_errors_end_a_command_with_one_line(
    error: TelepulseError, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught, one_line_errors("display-node"):
        raise error
    assert caught.value.code == 2
    out, err = capsys.readouterr()
    assert (out, err) == ("", f"display-node: {error}\n")


def test_other_errors_are_bugs_and_stay_as_they_are() -> None:
    with pytest.raises(KeyError), one_line_errors("display-node"):
        raise KeyError("a bug")


def test_without_an_error_nothing_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    with one_line_errors("display-node"):
        pass
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("error", "base"),
    [
        (SceneError("x"), ValueError),
        (WireError("version", "x"), ValueError),
        (AddressError("x"), OSError),
        (SourceError("x"), OSError),
        (OutputError("x"), OSError),
    ],
)
def test_each_error_is_ours_and_of_a_well_known_kind(
    error: TelepulseError, base: type[Exception]
) -> None:
    assert isinstance(error, TelepulseError)
    assert isinstance(error, base)
    assert str(error) == "x"


@pytest.fixture
def handlers() -> Iterator[None]:
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("handlers")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_asks_to_stop(number: signal.Signals) -> None:
    stops: list[bool] = []
    stop_on_signals(lambda: stops.append(True))
    signal.raise_signal(number)
    signal.raise_signal(number)
    assert stops == [True, True]
