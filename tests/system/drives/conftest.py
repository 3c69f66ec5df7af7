import pytest


@pytest.fixture(autouse=True)
def always_goes_first(goes_first: None) -> None:
    """Give the processes priority: drive and emulator share one, with a watchdog in real time."""
