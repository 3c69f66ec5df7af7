import pytest


@pytest.fixture(autouse=True)
def always_goes_first(goes_first: None) -> None:
    """Drive and emulator share a process here; its watchdog is not for the other tests' time."""
